//! When a stage keeps a checkpoint, and from which it goes on. Knows nothing of what is in one.

use std::fs;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::checkpoint::Checkpoint;
use crate::error::StageError;
use crate::io::{Io, Message};

/// The file in a stage's scratch folder.
pub const FILE: &str = "checkpoint";
/// What a damaged one is renamed to.
const DAMAGED: &str = "checkpoint.damaged";
/// A stage computes at least so many times longer than it spends on checkpoints.
// So that checkpoints take a hundredth of the time at most, however slow the disk.
const LEAST_WORK: u32 = 99;

/// Keeps the checkpoints of one stage while it goes through its steps.
pub struct Checkpointer<'a> {
    io: &'a Io<'a>,
    /// Steps in all.
    total: u64,
    /// The step of the last checkpoint.
    kept: u64,
    /// When it was kept.
    since: Instant,
    /// How long to wait until the next one.
    pause: Duration,
    /// Whether it was said that none can be kept.
    complained: bool,
}

impl<'a> Checkpointer<'a> {
    /// Before the first step of `total`.
    pub fn new(io: &'a Io<'a>, total: u64) -> Self {
        Self {
            io,
            total,
            kept: 0,
            since: Instant::now(),
            pause: io.checkpoint_every,
            complained: false,
        }
    }

    /// Goes on from an interrupted run, or from a finished result of fewer steps, if there is one
    /// that `rebuild` can make something of. What cannot be used is named and set aside.
    pub fn resume<T>(
        &mut self,
        mut rebuild: impl FnMut(&Checkpoint) -> Result<T, String>,
    ) -> Result<Option<T>, StageError> {
        self.sweep();
        let own = self.io.scratch.join(FILE);
        let earlier = self.io.earlier.clone();
        // The stage's own state first: it may be further than the finished one.
        for (path, finished) in [(Some(&own), false), (earlier.as_ref(), true)] {
            let Some(path) = path else { continue };
            match self.try_resume(path, &mut rebuild) {
                Ok(None) => {}
                Ok(Some((step, state))) => {
                    // Steps that are on disk already need not be kept again when the run is stopped
                    // at once.
                    self.kept = step;
                    (self.io.messages)(Message::Resumed {
                        step,
                        total: self.total,
                        finished,
                    });
                    return Ok(Some(state));
                }
                Err(problem) => self.set_aside(path, finished, &problem)?,
            }
        }
        Ok(None)
    }

    /// Removes what was being written when an earlier run was killed. What cannot be removed is in
    /// nobody's way.
    fn sweep(&self) {
        let entries = fs::read_dir(&self.io.scratch)
            .into_iter()
            .flatten()
            .flatten();
        // Nobody else writes here: the scratch folder is that of one key, whose lease this process
        // holds.
        for entry in
            entries.filter(|entry| entry.file_name() != FILE && entry.file_name() != DAMAGED)
        {
            let _ = fs::remove_file(entry.path());
        }
    }

    fn try_resume<T>(
        &self,
        path: &Path,
        rebuild: &mut impl FnMut(&Checkpoint) -> Result<T, String>,
    ) -> Result<Option<(u64, T)>, String> {
        let checkpoint = Checkpoint::read(path).map_err(|error| error.to_string())?;
        // A state beyond the last step is of no use here.
        let Some(checkpoint) = checkpoint.filter(|checkpoint| checkpoint.step <= self.total) else {
            return Ok(None);
        };
        rebuild(&checkpoint).map(|state| Some((checkpoint.step, state)))
    }

    /// A finished result's state belongs to someone else, and stays.
    fn set_aside(&self, path: &Path, finished: bool, problem: &str) -> Result<(), StageError> {
        self.io.warn(format!(
            "the checkpoint {} cannot be used: {problem}; starting afresh",
            path.display()
        ));
        if finished {
            return Ok(());
        }
        let file = |error: io::Error| StageError::File {
            path: path.to_owned(),
            problem: error.to_string(),
        };
        // Renamed and not removed, so that it can be looked into.
        fs::rename(path, path.with_file_name(DAMAGED)).map_err(file)
    }

    /// After a step: reports progress, and keeps a checkpoint if it is time to. An error when the
    /// run is being stopped; then the checkpoint is of this step.
    pub fn after(
        &mut self,
        step: u64,
        values: &[(&'static str, f64)],
        state: impl FnOnce() -> Checkpoint,
    ) -> Result<(), StageError> {
        // A stop is asked about first, so that the checkpoint below can be of this step.
        let stopped = self.io.progress(step as usize, self.total as usize, values);
        // When the run is stopped, the last steps are kept even if it is not time yet.
        if self.since.elapsed() >= self.pause || (stopped.is_err() && self.kept < step) {
            self.keep(step, state);
        }
        stopped
    }

    /// Keeps a checkpoint now. A stage that cannot keep one goes on without.
    pub fn keep(&mut self, step: u64, state: impl FnOnce() -> Checkpoint) {
        let begun = Instant::now();
        match state().write(&self.io.scratch.join(FILE)) {
            Ok(()) => self.kept = step,
            Err(_) if self.complained => {}
            Err(error) => {
                self.complained = true;
                let scratch = self.io.scratch.display();
                self.io.warn(format!(
                    "cannot keep a checkpoint in {scratch}: {error}; going on without"
                ));
            }
        }
        // From the end of the writing: the pause is time that was computed.
        self.since = Instant::now();
        let every = self.io.checkpoint_every;
        // Zero asks for one after every step, whatever it costs.
        self.pause = if every.is_zero() {
            every
        } else {
            every.max(begun.elapsed() * LEAST_WORK)
        };
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::PathBuf;
    use std::sync::Mutex;

    use artifacts_schema::Provenance;
    use compute::Device;
    use serde_json::json;

    use super::*;

    fn checkpoint(step: u64) -> Checkpoint {
        Checkpoint {
            step,
            tensors: BTreeMap::new(),
            notes: json!(null),
        }
    }

    /// A stage's surroundings, with the folder as scratch.
    fn with_io(
        scratch: &Path,
        earlier: Option<PathBuf>,
        stopped: bool,
        act: impl FnOnce(&Io),
    ) -> Vec<Message> {
        let said = Mutex::new(Vec::new());
        act(&Io {
            seed: 0,
            device: &Device::cpu(),
            inputs: BTreeMap::new(),
            outputs: scratch.join("out"),
            scratch: scratch.to_owned(),
            checkpoint_every: Duration::from_secs(3600),
            earlier,
            provenance: Provenance::default(),
            messages: &|message| said.lock().unwrap().push(message),
            cancelled: &|| stopped,
        });
        said.into_inner().unwrap()
    }

    #[test]
    fn a_stopped_stage_leaves_its_last_step_and_goes_on_from_it() {
        let folder = tempfile::tempdir().unwrap();
        with_io(folder.path(), None, true, |io| {
            let mut checkpointer = Checkpointer::new(io, 9);
            assert_eq!(checkpointer.resume(|found| Ok(found.step)).unwrap(), None);
            assert!(matches!(
                checkpointer.after(3, &[], || checkpoint(3)),
                Err(StageError::Cancelled)
            ));
        });
        let said = with_io(folder.path(), None, false, |io| {
            let mut checkpointer = Checkpointer::new(io, 9);
            assert_eq!(
                checkpointer.resume(|found| Ok(found.step)).unwrap(),
                Some(3)
            );
            checkpointer
                .after(4, &[], || panic!("it is not time for a checkpoint"))
                .unwrap();
        });
        assert_eq!(
            said[0],
            Message::Resumed {
                step: 3,
                total: 9,
                finished: false
            }
        );
    }

    #[test]
    fn a_damaged_checkpoint_is_named_and_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(FILE), "v1").unwrap();
        let said = with_io(folder.path(), None, false, |io| {
            assert_eq!(
                Checkpointer::new(io, 9)
                    .resume(|found| Ok(found.step))
                    .unwrap(),
                None
            );
        });
        let Message::Warning(text) = &said[0] else {
            panic!("{said:?}")
        };
        assert!(
            text.contains("checkpoint cannot be used: its content is damaged; starting afresh"),
            "{text}"
        );
        assert!(folder.path().join(DAMAGED).exists() && !folder.path().join(FILE).exists());
    }

    #[test]
    fn a_finished_result_is_extended_but_never_shortened() {
        let folder = tempfile::tempdir().unwrap();
        let earlier = folder.path().join("earlier");
        let scratch = folder.path().join("scratch");
        checkpoint(5).write(&earlier).unwrap();
        for (total, found) in [(5, Some(5)), (9, Some(5)), (4, None)] {
            with_io(&scratch, Some(earlier.clone()), false, |io| {
                assert_eq!(
                    Checkpointer::new(io, total)
                        .resume(|found| Ok(found.step))
                        .unwrap(),
                    found,
                    "{total}"
                );
            });
        }
    }

    #[test]
    fn a_checkpoint_that_cannot_be_written_does_not_end_the_stage() {
        let folder = tempfile::tempdir().unwrap();
        let said = with_io(&folder.path().join("gone"), None, false, |io| {
            let mut checkpointer = Checkpointer::new(io, 9);
            (1..4).for_each(|step| checkpointer.keep(step, || checkpoint(step)));
        });
        assert_eq!(said.len(), 1);
        let Message::Warning(text) = &said[0] else {
            panic!("{said:?}")
        };
        assert!(text.contains("cannot keep a checkpoint in"), "{text}");
    }
}
