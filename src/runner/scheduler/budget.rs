//! What may run beside what: by threads, memory and the device. Knows no stage.

use stages::Estimate;

/// What the stages of a run may take together.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Stages at once; they share as many threads.
    pub threads: usize,
    /// Bytes of main memory.
    pub memory: u64,
    /// Whether the device can be held by one stage only, as a GPU is.
    pub one_on_device: bool,
}

impl Budget {
    /// Whether a stage may begin beside those that run. Alone, any stage may.
    pub fn admits<'e>(
        &self,
        running: impl Iterator<Item = &'e Estimate> + Clone,
        stage: &Estimate,
    ) -> bool {
        // Estimates may be as large as they like: the sum must not wrap around and admit
        // everything.
        let memory = running.clone().fold(stage.memory, |sum, running| {
            sum.saturating_add(running.memory)
        });
        let device_taken =
            self.one_on_device && stage.device && running.clone().any(|running| running.device);
        let count = running.count();
        // Alone, whatever it needs: a stage that never began would let the run wait for ever.
        count == 0 || (count < self.threads && memory <= self.memory && !device_taken)
    }

    /// What to say of a stage that does not fit at all, and so runs alone.
    pub fn complaint(&self, stage: &Estimate) -> Option<String> {
        let gigabytes = |bytes: u64| format!("{:.1} GB", bytes as f64 / 1e9);
        (stage.memory > self.memory).then(|| {
            let needed = gigabytes(stage.memory);
            let allowed = gigabytes(self.memory);
            format!("it may need {needed} of memory, and --memory allows {allowed}; it runs alone")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stage(memory: u64, device: bool) -> Estimate {
        Estimate {
            memory,
            seconds: 1.0,
            device,
        }
    }

    #[test]
    fn stages_run_beside_each_other_within_threads_memory_and_device() {
        let budget = Budget {
            threads: 3,
            memory: 100,
            one_on_device: true,
        };
        let running = [stage(50, true)];
        assert!(budget.admits(running.iter(), &stage(50, false)));
        assert!(!budget.admits(running.iter(), &stage(51, false)));
        assert!(!budget.admits(running.iter(), &stage(1, true)));
        assert!(
            Budget {
                one_on_device: false,
                ..budget
            }
            .admits(running.iter(), &stage(1, true))
        );
        let three = [stage(1, false), stage(1, false), stage(1, false)];
        assert!(!budget.admits(three.iter(), &stage(1, false)));
    }

    #[test]
    fn what_is_too_large_runs_alone_and_is_complained_of() {
        let budget = Budget {
            threads: 3,
            memory: 100_000_000_000,
            one_on_device: false,
        };
        let large = stage(101_000_000_000, false);
        assert!(
            budget.admits([].iter(), &large) && !budget.admits([stage(0, false)].iter(), &large)
        );
        let text = budget.complaint(&large).unwrap();
        assert_eq!(
            text,
            "it may need 101.0 GB of memory, and --memory allows 100.0 GB; it runs alone"
        );
        assert_eq!(budget.complaint(&stage(1, false)), None);
    }
}
