//! Scripts for `sbatch`: one for each stage, an array for the shards of a stage, and one that
//! submits them all.

use std::collections::{BTreeMap, BTreeSet};

use super::quote::{command, shell};
use super::{Job, Workflow};

/// The second line of every script, by which an earlier export is known.
pub const MARK: &str = "# Written by `srnerf-dag export slurm`";

/// Seconds before the end of a job's time at which it is told to keep a checkpoint.
const WARNING: u32 = 120;

/// How to use the scripts.
const HEAD: &str = "\
#
#   sh FOLDER/submit.sh
#
# Start it where you would start `srnerf-dag run`: paths are relative to that folder, and the store in it must lie on a file system
# that all nodes share. Options for all jobs come from Slurm's own variables, such as SBATCH_PARTITION and SBATCH_ACCOUNT.
#
# A job begins when those that it reads from are done. Before its time is up it is told so, keeps a checkpoint, and queues itself
# again; then it goes on where it stopped. What is in the store already takes a moment. Submitting twice does no harm.
";

/// What every job does: run the stage, pass signals on, and queue itself again when it was cut off.
const BODY: &str = "\
again=no
trap 'again=yes; kill -USR1 $job' USR1
trap 'kill -TERM $job' TERM
COMMAND --threads \"$SLURM_CPUS_PER_TASK\" &
job=$!
code=0
wait $job || code=$?
# A signal ends the first `wait`, not the program.
while kill -0 $job 2>/dev/null; do code=0; wait $job || code=$?; done
if [ $code = 75 ] && [ $again = yes ]; then scontrol requeue \"$self\"; fi
exit $code
";

impl Workflow {
    /// All scripts by file name.
    pub fn slurm(&self, folder: &str) -> BTreeMap<String, String> {
        // `sbatch` reads words in its comments as a shell does.
        let folder = &shell(folder);
        let mut files: BTreeMap<String, String> = self
            .jobs
            .iter()
            .map(|job| (format!("{}.sh", job.stage_file()), self.script(job, folder)))
            .collect();
        files.insert("submit.sh".to_owned(), self.submit(folder));
        files.insert("show.sh".to_owned(), self.show(folder));
        files
    }

    fn submit(&self, folder: &str) -> String {
        let head = HEAD.replace("FOLDER", folder);
        let lines: String = self
            .jobs
            .iter()
            .enumerate()
            .map(|(at, job)| self.line(at, &job.needs, &job.stage_file()))
            .collect();
        // Only the last jobs: the others are done when these are.
        let last = self.line(self.jobs.len(), &self.last(), "show");
        format!(
            "#!/bin/sh\n{MARK} from the pipeline `{}`.\n{head}\nset -eu\nmkdir -p {folder}/logs\n\
             submit() {{ sbatch --parsable --kill-on-invalid-dep=yes \"$@\"; }}\n\n{lines}\n\
             # Shows all results in the output folder and prints the metrics, to its log.\n{last}\n\
             echo \"submitted {} jobs; the last one is $job_{}\"\n",
            self.pipeline,
            self.jobs.len() + 1,
            self.jobs.len(),
        )
    }

    fn line(&self, at: usize, needs: &BTreeSet<usize>, file: &str) -> String {
        // `afterok`, since a job whose inputs failed could only fail. `kill-on-invalid-dep` removes
        // such a job, which would otherwise wait for ever.
        let needs: String = needs.iter().map(|need| format!(":$job_{need}")).collect();
        let after = if needs.is_empty() {
            String::new()
        } else {
            format!("--dependency=afterok{needs} ")
        };
        format!("job_{at}=$(submit {after}\"$(dirname \"$0\")/{file}.sh\")\n")
    }

    fn script(&self, job: &Job, folder: &str) -> String {
        let (log, array, stage, me) = match job.shards {
            Some(shards) => (
                "%x-%A_%a",
                format!("#SBATCH --array=1-{shards}\n"),
                format!("{}.\"$SLURM_ARRAY_TASK_ID\"", job.stage),
                "\"${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID\"",
            ),
            None => (
                "%x-%j",
                String::new(),
                job.stage.clone(),
                "\"$SLURM_JOB_ID\"",
            ),
        };
        let run = format!("{} --only {stage}", command(&self.command));
        format!(
            // `B:` signals the script alone, which passes it on. A log is appended to: by Slurm's
            // default, a job that is queued again empties it.
            "#!/bin/sh\n{MARK} from the pipeline `{}`.\n{}{array}#SBATCH --output={folder}/logs/{log}.log\n\
             #SBATCH --signal=B:USR1@{WARNING}\n#SBATCH --requeue\n#SBATCH --open-mode=append\n\nself={me}\n{}",
            self.pipeline,
            request(job),
            BODY.replace("COMMAND", &run),
        )
    }

    fn show(&self, folder: &str) -> String {
        format!(
            "#!/bin/sh\n{MARK} from the pipeline `{}`.\n#SBATCH --job-name={}\n#SBATCH --output={folder}/logs/%x-%j.log\n\n{}\n",
            self.pipeline,
            self.pipeline,
            command(&self.command),
        )
    }
}

fn request(job: &Job) -> String {
    let super::Resources {
        threads,
        memory,
        minutes,
    } = job.resources;
    format!(
        "#SBATCH --job-name={}\n#SBATCH --cpus-per-task={threads}\n#SBATCH --mem={memory}M\n#SBATCH --time={minutes}\n",
        // It is part of the log's name, in which a slash would be a folder.
        job.stage.replace('/', "-")
    )
}

impl Job {
    /// The name of its script: shards and their merge have names of their own.
    fn stage_file(&self) -> String {
        if self.shards.is_some() {
            format!("{}.shards", self.stage)
        } else {
            self.stage.clone()
        }
    }
}
