//! Asking again, a few times and with growing pauses. One place for all requests, so that their sum
//! is bounded.

use std::time::{Duration, Instant};

use super::fault::Fault;

/// How long to try.
#[derive(Clone, Copy, Debug)]
pub struct Patience {
    /// How often to ask in all.
    pub attempts: u32,
    /// The pause after the first attempt; each later one is three times as long.
    pub pause: Duration,
    /// No attempt begins later than this after the first one.
    pub total: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            attempts: 4,
            pause: Duration::from_millis(200),
            total: Duration::from_secs(30),
        }
    }
}

impl Patience {
    /// Asks until there is an answer, or a fault that will not pass.
    pub async fn ask<T, F: Future<Output = Result<T, Fault>>>(
        &self,
        mut ask: impl FnMut() -> F,
    ) -> Result<T, Fault> {
        let begun = Instant::now();
        let mut pause = self.pause;
        // The last attempt stands behind the loop: after it there is nothing to wait for.
        for _ in 1..self.attempts {
            match ask().await {
                Err(fault) if fault.may_pass() && begun.elapsed() + pause < self.total => {}
                answer => return answer,
            }
            tokio::time::sleep(pause).await;
            pause *= 3;
        }
        ask().await
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn attempts(fault: impl Fn() -> object_store::Error, ends_well_after: u32) -> (u32, bool) {
        let patience = Patience {
            attempts: 4,
            pause: Duration::from_millis(1),
            total: Duration::from_secs(9),
        };
        let count = Cell::new(0);
        let ask = async || {
            count.set(count.get() + 1);
            if count.get() > ends_well_after {
                Ok(())
            } else {
                Err(Fault::Remote(fault()))
            }
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        let well = runtime.block_on(patience.ask(ask)).is_ok();
        (count.get(), well)
    }

    #[test]
    fn what_may_pass_is_asked_again_but_not_forever() {
        let broken = || object_store::Error::Generic {
            store: "test",
            source: "reset".into(),
        };
        assert_eq!(attempts(broken, 0), (1, true));
        assert_eq!(attempts(broken, 3), (4, true));
        assert_eq!(attempts(broken, 9), (4, false));
    }

    #[test]
    fn what_will_not_pass_is_asked_once() {
        let missing = || object_store::Error::NotFound {
            path: "x".into(),
            source: "x".into(),
        };
        assert_eq!(attempts(missing, 9), (1, false));
    }
}
