//! A Snakefile. Its rules declare stamps, not artifacts, so that what Snakemake removes before a
//! job is never work that was done.

use std::collections::BTreeSet;

use super::quote::{command, python, shell};
use super::{Job, Workflow};

/// The first line, by which an earlier export is known.
pub const MARK: &str = "# Written by `srnerf-dag export snakemake`";

/// How to use the file.
const HEAD: &str = "\
#
#   snakemake --cores 8 --rerun-incomplete --nolock
#   snakemake --executor slurm --jobs 50 --slurm-array-jobs all --rerun-incomplete --nolock
#   snakemake --executor kubernetes --jobs 50 --container-image IMAGE --rerun-incomplete --nolock
#
# Start it where you would start `srnerf-dag run`: paths are relative to that folder. On a cluster the store lies in a folder that
# all nodes share; elsewhere export with `--remote URL`. After changing the pipeline, export it again: `params` then say what is new.
#
# A rule is a stage. Its stamp holds the digests of the stage's outputs, which lie in the store: a stage that comes to the same result
# as before leaves its stamp as it was, and what depends on it is not run. A job that is cut off goes on from its checkpoint when
# it is started again, which `retries` does by itself; the store needs no lock around it. `--config program=PATH` names another program, `stamps=FOLDER` another folder.
";

impl Workflow {
    pub fn snakefile(&self) -> String {
        let [program, arguments @ ..] = &self.command[..] else {
            return String::new();
        };
        let names = rule_names(&self.jobs);
        let last: Vec<String> = self
            .last()
            .iter()
            .map(|&at| stamps(&self.jobs[at]))
            .collect();
        let rules: String = self
            .jobs
            .iter()
            .zip(&names)
            .map(|(job, name)| self.rule(job, name))
            .collect();
        format!(
            "{MARK} from the pipeline `{}`.\n{HEAD}\n\
             PROGRAM = config.get(\"program\", {})\n\
             STAMPS = config.get(\"stamps\", \"stamps/{}\")\n\
             RETRIES = int(config.get(\"retries\", 3))\n\
             RUN = PROGRAM + {}\n\n\n\
             localrules: all\n\n\n\
             # Every result is in the store by now: shows them in the output folder, and prints the metrics.\n\
             rule all:\n    input: {}\n    shell: \"{{RUN}}\"\n{rules}",
            self.pipeline,
            // Quoted twice: Python reads the text, and the shell what is in it.
            python(&shell(program)),
            self.pipeline,
            python(&format!(" {}", command(arguments))),
            last.join(", "),
        )
    }

    fn rule(&self, job: &Job, name: &str) -> String {
        let inputs: Vec<String> = job.needs.iter().map(|&at| stamps(&self.jobs[at])).collect();
        let inputs = if inputs.is_empty() {
            String::new()
        } else {
            format!("    input: {}\n", inputs.join(", "))
        };
        let (output, stage) = match job.shards {
            Some(_) => (
                format!("STAMPS + \"/{}.{{shard}}.json\"", job.stage),
                format!("{}.{{wildcards.shard}}", job.stage),
            ),
            None => (stamps(job), job.stage.clone()),
        };
        // A wildcard matches any text, and so the stamps of other stages whose names begin alike.
        let constraint = job.shards.map_or(String::new(), |_| {
            "    wildcard_constraints: shard=r\"\\d+\"\n".to_owned()
        });
        let resources = &job.resources;
        format!(
            "\n\nrule {name}:\n{inputs}    output: {output}\n{constraint}    params: recipe={}\n    threads: {}\n    \
             resources: mem_mb={}, runtime={}\n    retries: RETRIES\n    \
             shell: \"{{RUN}} --only {stage} --stamp {{output}} --threads {{threads}}\"\n",
            recipe(job),
            resources.threads,
            resources.memory,
            resources.minutes,
        )
    }
}

/// The first digits suffice to tell recipes apart.
fn recipe(job: &Job) -> String {
    let short: Vec<String> = job
        .recipes
        .iter()
        .map(|digest| format!("\"{}\"", &digest.to_string()[..16]))
        .collect();
    match job.shards {
        Some(_) => format!(
            "lambda wildcards: [{}][int(wildcards.shard) - 1]",
            short.join(", ")
        ),
        None => short.concat(),
    }
}

/// The stamps of a job, as an expression.
fn stamps(job: &Job) -> String {
    match job.shards {
        Some(shards) => format!(
            "[f\"{{STAMPS}}/{}.{{shard}}.json\" for shard in range(1, {})]",
            job.stage,
            shards + 1
        ),
        None => format!("STAMPS + \"/{}.json\"", job.stage),
    }
}

/// Names of stages as names of rules, each once: `i3ds_1_render`, `i3ds_1_render_shard`.
fn rule_names(jobs: &[Job]) -> Vec<String> {
    // `all` is the rule at the top of the file.
    let mut taken = BTreeSet::from(["all".to_owned()]);
    let name = |job: &Job| {
        let mut name = job.stage.replace(['.', '-', '/'], "_")
            + if job.shards.is_some() { "_shard" } else { "" };
        // `a.b` and `a-b` become the same name.
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        name
    };
    jobs.iter().map(name).collect()
}
