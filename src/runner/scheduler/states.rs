//! The states of a run's stages, one each. Knows nothing of why a stage goes from one to another.

use std::collections::{BTreeMap, BTreeSet};

use artifacts_schema::Digest;
use stages::Estimate;

use crate::runner::explain::Reason;
use crate::store::manifest::Manifest;
use crate::store::runs::StageRun;

/// A stage that must run.
pub struct Queued {
    pub key: Digest,
    /// What is in the key.
    pub manifest: Manifest,
    /// Why it must run.
    pub reason: Reason,
    /// What it will take.
    pub estimate: Estimate,
    /// The key under which it was begun on a GPU that failed, if it goes on on the CPU.
    pub begun_as: Option<Digest>,
}

/// What a stage of a run is doing.
pub enum State {
    /// The run needs no result of it. It stays so.
    Unneeded,
    /// Some of its inputs are missing. It becomes `Ready` with the last of them, or `Over` if one
    /// will never come.
    Waiting {
        /// How many are missing.
        missing: usize,
    },
    /// All its inputs are there, and nobody has looked for its result yet.
    Ready,
    /// It has no result and must run. It waits for room.
    Queued(Box<Queued>),
    /// The scheduler deals with it just now, and gives it its next state before the next stage.
    Held,
    /// Another process computes it. It becomes `Ready` again a little later, to look for the
    /// result.
    Elsewhere,
    /// A thread of this process computes it.
    Running(Box<Queued>),
    /// Nothing more happens to it in this run.
    Over(StageRun),
}

/// A [`State`] without what is in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Unneeded,
    Waiting,
    Ready,
    Queued,
    Held,
    Elsewhere,
    Running,
    Over,
}

impl State {
    fn kind(&self) -> Kind {
        match self {
            Self::Unneeded => Kind::Unneeded,
            Self::Waiting { .. } => Kind::Waiting,
            Self::Ready => Kind::Ready,
            Self::Queued(_) => Kind::Queued,
            Self::Held => Kind::Held,
            Self::Elsewhere => Kind::Elsewhere,
            Self::Running(_) => Kind::Running,
            Self::Over(_) => Kind::Over,
        }
    }
}

/// The states of all stages, and which stages are in a given one.
pub struct States {
    of: Vec<State>,
    /// With ten thousand stages, nobody may look through all of them for the next.
    by_kind: BTreeMap<Kind, BTreeSet<usize>>,
}

impl States {
    /// Of so many stages that are not needed.
    pub fn new(count: usize) -> Self {
        Self {
            of: (0..count).map(|_| State::Unneeded).collect(),
            by_kind: BTreeMap::from([(Kind::Unneeded, (0..count).collect())]),
        }
    }

    /// A stage's state.
    pub fn get(&self, at: usize) -> &State {
        &self.of[at]
    }

    /// Gives a stage its next state, and returns the one before.
    pub fn set(&mut self, at: usize, state: State) -> State {
        let kind = state.kind();
        let before = std::mem::replace(&mut self.of[at], state);
        // The array holds the truth. These sets are only kept for speed, and change here alone.
        if before.kind() != kind {
            if let Some(those) = self.by_kind.get_mut(&before.kind()) {
                those.remove(&at);
            }
            self.by_kind.entry(kind).or_default().insert(at);
        }
        before
    }

    /// The stages in a state, in the order of the pipeline.
    pub fn all(&self, kind: Kind) -> impl Iterator<Item = usize> + Clone {
        self.by_kind.get(&kind).into_iter().flatten().copied()
    }

    /// The stages that must run and are in a state, with what is known of them.
    pub fn known(&self, kind: Kind) -> impl Iterator<Item = (usize, &Queued)> + Clone {
        self.all(kind).filter_map(|at| match &self.of[at] {
            State::Queued(stage) | State::Running(stage) => Some((at, &**stage)),
            _ => None,
        })
    }

    /// How every stage ended, and `unfinished` for those that the run needed and that did not.
    pub fn close(self, unfinished: &StageRun) -> BTreeMap<usize, StageRun> {
        let needed = self.of.into_iter().enumerate();
        needed
            .filter_map(|(at, state)| match state {
                State::Unneeded => None,
                State::Over(run) => Some((at, run)),
                _ => Some((at, unfinished.clone())),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_is_in_one_state_at_a_time() {
        let mut states = States::new(3);
        states.set(2, State::Ready);
        states.set(0, State::Ready);
        assert_eq!(states.all(Kind::Ready).collect::<Vec<_>>(), [0, 2]);
        assert!(matches!(states.set(0, State::Elsewhere), State::Ready));
        assert_eq!(states.all(Kind::Ready).collect::<Vec<_>>(), [2]);
        assert_eq!(states.all(Kind::Elsewhere).collect::<Vec<_>>(), [0]);
        assert_eq!(states.all(Kind::Unneeded).collect::<Vec<_>>(), [1]);
    }

    #[test]
    fn what_was_needed_and_has_not_ended_was_stopped() {
        let mut states = States::new(3);
        states.set(0, State::Waiting { missing: 1 });
        states.set(1, State::Over(StageRun::cached(Digest::new([7; 32]))));
        let ends = states.close(&StageRun::stopped());
        assert_eq!(ends[&0], StageRun::stopped());
        assert_eq!(ends[&1], StageRun::cached(Digest::new([7; 32])));
        assert_eq!(ends.len(), 2, "nobody asked for the third");
    }
}
