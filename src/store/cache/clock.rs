//! What time it is to a store. Knows nothing of files.

use std::time::{Duration, SystemTime};

/// The system's clock, or in tests one that is ahead: what has just been written is then old,
/// without waiting.
#[derive(Clone, Copy, Debug, Default)]
pub struct Clock {
    /// By how much.
    pub ahead: Duration,
}

impl Clock {
    /// The time.
    pub fn now(self) -> SystemTime {
        SystemTime::now() + self.ahead
    }
}
