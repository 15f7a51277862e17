//! Asking again, a few times and with growing pauses. One place for all requests, so that their sum
//! is bounded.

use std::pin::Pin;
use std::time::{Duration, Instant};

use object_store::retry::{RetryContext, RetryFailure, RetryPolicy};

use super::fault::RemoteFault;

/// How long to try.
#[derive(Clone, Copy, Debug)]
pub struct RetryLimits {
    /// How often to ask in all.
    pub attempts: u32,
    /// The pause after the first attempt; each later one is three times as long.
    pub pause: Duration,
    /// No attempt begins later than this after the first fault.
    pub total: Duration,
}

impl Default for RetryLimits {
    fn default() -> Self {
        Self {
            attempts: 4,
            pause: Duration::from_millis(200),
            total: Duration::from_secs(30),
        }
    }
}

impl RetryLimits {
    /// Asks until there is an answer, or a fault that will not pass.
    pub async fn ask<T, F: Future<Output = Result<T, RemoteFault>>>(
        &self,
        ask: impl FnMut() -> F,
    ) -> Result<T, RemoteFault> {
        self.ask_by(Instant::now, ask).await
    }

    /// The same by this clock.
    async fn ask_by<T, F: Future<Output = Result<T, RemoteFault>>>(
        &self,
        now: impl Fn() -> Instant,
        mut ask: impl FnMut() -> F,
    ) -> Result<T, RemoteFault> {
        let mut pause = self.pause;
        let mut first = None;
        // The last attempt stands behind the loop: after it there is nothing to wait for.
        for _ in 1..self.attempts {
            let answer = ask().await;
            // From the first fault on, not the first attempt: an upload that went well for an hour
            // is worth another attempt.
            let since = *first.get_or_insert_with(&now);
            match answer {
                Err(fault) if fault.may_pass() && now() - since + pause < self.total => {}
                answer => return answer,
            }
            tokio::time::sleep(pause).await;
            pause *= 3;
        }
        ask().await
    }
}

/// A piece of an upload that has failed is sent again by itself, since the client has numbered it.
impl RetryPolicy for RetryLimits {
    fn retry<'s, 'f>(
        &'s self,
        context: RetryContext,
    ) -> Pin<Box<dyn Future<Output = bool> + Send + 'f>>
    where
        's: 'f,
        Self: 'f,
    {
        let may_pass = match context.failure {
            // S3 can say in its answer's text that it has failed after all.
            RetryFailure::Status(status) => matches!(status.as_u16(), 200 | 408 | 429 | 500..),
            _ => true,
        };
        let attempt = context.attempt as u32;
        // The client counts attempts from 1, so that the exponent below is never negative.
        let again = may_pass && attempt < self.attempts;
        Box::pin(async move {
            if again {
                tokio::time::sleep(self.pause * 3u32.pow(attempt - 1)).await;
            }
            again
        })
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn attempts(fault: impl Fn() -> object_store::Error, ends_well_after: u32) -> (u32, bool) {
        let retry = RetryLimits {
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
                Err(RemoteFault::Remote(fault()))
            }
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        let well = runtime.block_on(retry.ask(ask)).is_ok();
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
    fn what_went_well_for_an_hour_is_asked_again() {
        let retry = RetryLimits {
            pause: Duration::ZERO,
            ..RetryLimits::default()
        };
        let clock = Cell::new(Instant::now());
        let ask = async || {
            clock.set(clock.get() + Duration::from_secs(3600));
            Err::<(), _>(RemoteFault::Remote(object_store::Error::Generic {
                store: "test",
                source: "reset".into(),
            }))
        };
        let begun = clock.get();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        let asked = runtime.block_on(retry.ask_by(|| clock.get(), ask));
        assert!(asked.is_err());
        let hours = (clock.get() - begun).as_secs() / 3600;
        assert_eq!(hours, 2, "and not once more, an hour after the first fault");
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
