//! What has become of a remote during a run: whether it still answers and takes results, and what
//! the user should hear of it.

use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard};

use artifacts_schema::Digest;

use super::fault::RemoteFault;

/// What has become of a remote.
#[derive(Default)]
pub struct Health(Mutex<State>);

#[derive(Default)]
struct State {
    /// It does not answer: nothing more is read or written.
    lost: bool,
    /// It does not take results: nothing more is written.
    closed: bool,
    /// Keys that were asked for: who waits for another process to compute one does not ask again
    /// and again.
    asked: BTreeSet<Digest>,
    /// Keys whose results there are damaged, and will be replaced.
    damaged: BTreeSet<Digest>,
    /// What the user has not heard yet.
    notices: Vec<String>,
}

impl Health {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0
            .lock()
            // What a thread that panicked leaves here is at worst a notice that nobody hears.
            .unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Whether it has stopped answering.
    pub fn is_lost(&self) -> bool {
        self.state().lost
    }

    /// Whether a key is asked for the first time.
    pub fn is_new(&self, key: &Digest) -> bool {
        self.state().asked.insert(*key)
    }

    /// Whether writing to it makes sense.
    pub fn takes_results(&self) -> bool {
        let state = self.state();
        !state.lost && !state.closed
    }

    /// Whether its result for a key was found damaged.
    pub fn is_damaged(&self, key: &Digest) -> bool {
        self.state().damaged.contains(key)
    }

    /// What the user has not heard yet.
    pub fn notices(&self) -> Vec<String> {
        std::mem::take(&mut self.state().notices)
    }

    /// Reading a result failed.
    pub fn read_failed(&self, name: &str, key: &Digest, fault: &RemoteFault) {
        let mut state = self.state();
        // One damaged result is no reason to give up the remote.
        if let RemoteFault::Damaged(what) = fault {
            if state.damaged.insert(*key) {
                state.notices.push(format!(
                    "{name} has a damaged result, which does not count: {what}"
                ));
            }
        } else if !std::mem::replace(&mut state.lost, true) {
            state
                .notices
                .push(format!("{name}: {fault}; going on without it"));
        }
    }

    /// Writing a result failed: since nothing answers, or since results are not taken.
    pub fn write_failed(&self, name: &str, fault: &RemoteFault) {
        let mut state = self.state();
        // Stages end on several threads, and the same fault should be told once.
        if state.lost || state.closed {
            return;
        }
        let notice = if let RemoteFault::Local(_) = fault {
            // Nothing of the remote's: it goes on being asked.
            format!("a result does not go to {name}: {fault}; `store push` sends what is sound")
        } else if fault.may_pass() {
            // It was asked several times by now: what would have passed has not.
            state.lost = true;
            format!("{name}: {fault}; going on without it")
        } else {
            state.closed = true;
            format!("{name} takes no results: {fault}; they stay here, for `store push`")
        };
        state.notices.push(notice);
    }
}

#[cfg(test)]
mod tests {
    use std::io;
    use std::path::Path;

    use super::*;
    use crate::store::error::StoreError;

    #[test]
    fn a_fault_of_ours_is_not_the_remotes() {
        let health = Health::default();
        let gone = StoreError::io(
            "read",
            Path::new(".srnerf/cas/3f/3f9a"),
            io::ErrorKind::NotFound.into(),
        );
        health.write_failed("shared", &RemoteFault::Local(gone));
        let [notice] = &health.notices()[..] else {
            panic!("one notice")
        };
        assert!(
            notice.starts_with("a result does not go to shared: cannot read .srnerf/cas/3f/3f9a: "),
            "{notice}"
        );
        assert!(health.takes_results() && !health.is_lost());
        health.write_failed("shared", &RemoteFault::Damaged("no".into()));
        assert!(health.notices()[0].starts_with("shared takes no results: no; "));
        assert!(!health.takes_results());
    }
}
