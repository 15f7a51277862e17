//! Pipelines as jobs of other schedulers. Whether those take them is tried by `tests/snakemake` and
//! `tests/slurm`.

use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};

use crate::space::Space;

#[test]
fn a_snakefile_has_a_rule_for_each_stage_and_says_what_decides_it() {
    let space = Space::new();
    space.ok(&[
        "export",
        "snakemake",
        "tiny.ron",
        "--set",
        "up.filter=Lanczos",
    ]);
    let text = fs::read_to_string(space.path("Snakefile")).unwrap();
    assert!(
        text.starts_with("# Written by `srnerf-dag export snakemake` from the pipeline `tiny`.\n"),
        "{text}"
    );
    for part in [
        "rule all:\n    input: STAMPS + \"/again.json\"\n    shell: \"{RUN}\"\n",
        "rule up:\n    input: STAMPS + \"/scene.json\"\n    output: STAMPS + \"/up.json\"\n    params: recipe=\"",
        "    shell: \"{RUN} --only up --stamp {output} --threads {threads}\"\n",
        "--set up.filter=Lanczos",
    ] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
    let recipes = |text: &str| {
        text.lines()
            .filter(|line| line.contains("recipe="))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    space.ok(&["run", "tiny.ron"]);
    space.ok(&["export", "snakemake", "tiny.ron"]);
    let other = recipes(&fs::read_to_string(space.path("Snakefile")).unwrap());
    let same: Vec<bool> = recipes(&text)
        .iter()
        .zip(&other)
        .map(|(a, b)| a == b)
        .collect();
    assert_eq!(same, [true, false, true], "only `up` has another filter");
}

#[test]
fn shards_are_one_rule_and_one_array() {
    let space = Space::new();
    let smoke = format!("{}/pipelines/smoke.ron", env!("CARGO_MANIFEST_DIR"));
    let sharded = [
        smoke.as_str(),
        "--set",
        "i3ds.render.shards=3",
        "--set",
        "i3ds.count=1",
    ];
    space.ok(&[&["export", "snakemake"], &sharded[..]].concat());
    let text = fs::read_to_string(space.path("Snakefile")).unwrap();
    assert!(text.contains("rule i3ds_1_render_shard:\n"), "{text}");
    assert!(
        text.contains("output: STAMPS + \"/i3ds.1.render.{shard}.json\"\n"),
        "{text}"
    );
    assert!(
        text.contains(
            "input: [f\"{STAMPS}/i3ds.1.render.{shard}.json\" for shard in range(1, 4)]\n"
        ),
        "{text}"
    );
    space.ok(&[&["export", "slurm"], &sharded[..]].concat());
    let array = fs::read_to_string(space.path("slurm/i3ds.1.render.shards.sh")).unwrap();
    assert!(
        array.contains("#SBATCH --array=1-3\n") && array.contains("#SBATCH --signal=B:USR1@120\n"),
        "{array}"
    );
    let submit = fs::read_to_string(space.path("slurm/submit.sh")).unwrap();
    assert!(
        submit.contains("job_4=$(submit --dependency=afterok:$job_3 "),
        "{submit}"
    );
}

#[test]
fn somebody_elses_file_is_not_overwritten() {
    let space = Space::new();
    fs::write(space.path("Snakefile"), "rule mine:\n").unwrap();
    let said = space.say(&["export", "snakemake", "tiny.ron"]);
    assert_eq!(said.code, 2);
    assert!(
        said.err.contains("Snakefile is there already"),
        "{}",
        said.err
    );
    assert_eq!(
        fs::read_to_string(space.path("Snakefile")).unwrap(),
        "rule mine:\n"
    );
    space.ok(&["export", "snakemake", "tiny.ron", "--to", "other/Snakefile"]);
    space.ok(&["export", "snakemake", "tiny.ron", "--to", "other/Snakefile"]);
}

/// A job's script as Slurm would start it; what it asks of Slurm goes to the file `asked`.
fn job(space: &Space, script: &str) -> Command {
    fs::create_dir_all(space.path("bin")).unwrap();
    fs::write(
        space.path("bin/scontrol"),
        "#!/bin/sh\necho \"$@\" >> asked\n",
    )
    .unwrap();
    fs::set_permissions(
        space.path("bin/scontrol"),
        fs::Permissions::from_mode(0o755),
    )
    .unwrap();
    let path = format!(
        "{}:{}",
        space.path("bin").display(),
        std::env::var("PATH").unwrap()
    );
    let mut command = Command::new("sh");
    command
        .arg(script)
        .current_dir(space.path(""))
        .env("PATH", path);
    command
        .env("SLURM_JOB_ID", "7")
        .env("SLURM_CPUS_PER_TASK", "1")
        .stderr(Stdio::piped());
    command
}

#[test]
fn a_job_that_is_warned_of_its_end_queues_itself_again() {
    let space = Space::new();
    let slow = "scene.source=Procedural(views: 6, size: (320, 240), samples: 4)";
    space.ok(&["export", "slurm", "tiny.ron", "--set", slow]);
    let mut child = job(&space, "slurm/scene.sh").spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap())
        .lines()
        .map_while(Result::ok);
    assert!(lines.any(|line| line.starts_with("scene: running")));
    assert!(
        Command::new("kill")
            .args(["-USR1", &child.id().to_string()])
            .status()
            .unwrap()
            .success()
    );
    lines.for_each(drop);
    assert_eq!(child.wait().unwrap().code(), Some(75));
    assert_eq!(
        fs::read_to_string(space.path("asked")).unwrap(),
        "requeue 7\n"
    );
}

#[test]
fn a_folder_with_a_space_in_its_name_is_one_word() {
    let space = Space::new();
    space.ok(&["export", "slurm", "tiny.ron", "--to", "my jobs"]);
    let mut submit = job(&space, "my jobs/submit.sh");
    fs::write(space.path("bin/sbatch"), "#!/bin/sh\necho 1\n").unwrap();
    fs::set_permissions(space.path("bin/sbatch"), fs::Permissions::from_mode(0o755)).unwrap();
    assert!(submit.status().unwrap().success());
    assert!(space.path("my jobs/logs").is_dir() && !space.path("my").exists());
    for (script, log) in [("up", "%x-%j"), ("show", "%x-%j")] {
        let text = fs::read_to_string(space.path(&format!("my jobs/{script}.sh"))).unwrap();
        let line = format!("#SBATCH --output='my jobs'/logs/{log}.log\n");
        assert!(text.contains(&line), "{line} is not in\n{text}");
    }
}

#[test]
fn jobs_in_their_order_compute_the_pipeline() {
    let space = Space::new();
    space.ok(&["export", "slurm", "tiny.ron"]);
    assert_eq!(
        job(&space, "slurm/up.sh").status().unwrap().code(),
        Some(3),
        "before what it reads"
    );
    for stage in ["scene", "up", "again", "show"] {
        assert!(
            job(&space, &format!("slurm/{stage}.sh"))
                .status()
                .unwrap()
                .success(),
            "{stage}"
        );
    }
    assert_eq!(
        space.ok(&["run", "tiny.ron", "--json"]).last()["ran"],
        serde_json::json!([])
    );
    assert!(!space.path("asked").exists());
}

#[test]
fn curves_and_scores_of_a_run_go_to_tensorboard() {
    let space = Space::new();
    fs::write(
        space.path("fit.ron"),
        r#"(name: "fit", stages: {
            "scene": Scene(source: Procedural(views: 3, size: (32, 24), samples: 1), downscale: 2, holdout: 2),
            "fit": Fit(images: "scene.train", steps: 100, samples: 512, field: (levels: 2, log2_table: 8, occupancy_resolution: 8)),
        })"#,
    )
    .unwrap();
    space.ok(&["run", "fit.ron"]);
    let said = space.ok(&["export", "tensorboard", "-o", "curves"]);
    assert!(
        said.out.contains("tensorboard --logdir curves"),
        "{}",
        said.out
    );
    let files = space.files("curves");
    let (path, bytes) = files.first_key_value().unwrap();
    assert!(path.starts_with("fit") && files.len() == 1, "{files:?}");
    // The header, and the losses by name.
    assert!(bytes.windows(13).any(|part| part == b"brain.Event:2"));
    assert!(bytes.windows(4).any(|part| part == b"loss"));
    // The same log makes the same file, over the one that is there.
    space.ok(&["export", "tensorboard", "-o", "curves"]);
    space.assert_files("curves", &files);
    let said = space.say(&["export", "tensorboard", "-o", "fit.ron"]);
    assert_eq!(said.code, 2, "{}", said.err);
}
