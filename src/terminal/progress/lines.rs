//! Progress as plain lines on stderr: for logs, pipes and batch jobs.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use artifacts_schema::Digest;
use stages::Message;

use super::{Event, Progress, Verbosity, duration, figure, figures};
use crate::terminal::output::{size, tell};

/// How long a running stage may say nothing but that it goes on.
const PAUSE: Duration = Duration::from_secs(10);

/// So many results that are there already are named one by one.
const NAMED: usize = 100;

/// Tells events line by line.
pub struct Lines {
    verbosity: Verbosity,
    running: BTreeMap<String, Running>,
}

/// A stage that runs. Its pace is measured over its last two lines. Its pace of long ago tells little,
/// since other stages come and go beside it; and between two lines some stages make only a few steps.
struct Running {
    before: Reached,
    last: Reached,
}

/// A step, and when it was reached.
#[derive(Clone, Copy)]
struct Reached {
    step: u64,
    at: Instant,
}

impl Reached {
    fn now(step: u64) -> Self {
        Self {
            step,
            at: Instant::now(),
        }
    }
}

impl Running {
    fn new(from: u64) -> Self {
        Self {
            before: Reached::now(from),
            last: Reached::now(from),
        }
    }

    /// Steps a second up to this one, which becomes the last.
    fn pace(&mut self, step: u64) -> f64 {
        let now = Reached::now(step);
        let seconds = (now.at - self.before.at).as_secs_f64();
        let rate = step.saturating_sub(self.before.step) as f64 / seconds;
        self.before = self.last;
        self.last = now;
        rate
    }
}

impl Lines {
    /// Lines as many as asked for.
    pub fn new(verbosity: Verbosity) -> Self {
        Self {
            verbosity,
            running: BTreeMap::new(),
        }
    }

    /// The line for an event, if it has one.
    pub fn line(&mut self, event: &Event) -> Option<String> {
        let keys = self.verbosity == Verbosity::Verbose;
        let detail = |text: String| if keys { text } else { String::new() };
        let (level, line) = match event {
            // With keys all are named: who asks for them wants each.
            Event::Cached { results } if results.len() > NAMED && !keys => (
                Verbosity::Normal,
                format!("{} stages: cached", results.len()),
            ),
            Event::Cached { results } => {
                let line = |(stage, key): &(&str, Digest)| {
                    format!("{stage}: cached{}", detail(format!(" {key}")))
                };
                (
                    Verbosity::Normal,
                    results.iter().map(line).collect::<Vec<_>>().join("\n"),
                )
            }
            Event::Fetched { stage, key, bytes } => {
                let line = format!(
                    "{stage}: fetched from the remote, {}{}",
                    size(*bytes),
                    detail(format!(" {key}"))
                );
                (Verbosity::Normal, line)
            }
            Event::Notice { text } => (Verbosity::Quiet, format!("warning: {text}")),
            Event::Started { stage, key, reason } => {
                self.running.insert((*stage).to_owned(), Running::new(0));
                (
                    Verbosity::Normal,
                    format!("{stage}: running ({reason}){}", detail(format!(" {key}"))),
                )
            }
            Event::Finished {
                stage,
                seconds,
                record,
            } => {
                self.running.remove(*stage);
                let outputs = record
                    .outputs
                    .iter()
                    .map(|(name, output)| format!(" {name}={}", output.digest));
                let line = format!(
                    "{stage}: done in {}{}",
                    duration(*seconds),
                    detail(outputs.collect())
                );
                (Verbosity::Normal, line)
            }
            Event::Said { stage, message } => return self.said(stage, message),
            Event::Failed { stage, error, arms } => {
                let arms = match arms {
                    [] => String::new(),
                    [arm] => format!(" (the arm {arm} fails)"),
                    _ => format!(" (these arms fail: {})", arms.join(", ")),
                };
                (Verbosity::Quiet, format!("{stage}: error: {error}{arms}"))
            }
            Event::Stopped { stage } => (Verbosity::Normal, format!("{stage}: stopped")),
            Event::Blocked { stage, by } => (
                Verbosity::Normal,
                format!("{stage}: not run, since {by} failed"),
            ),
            Event::Waiting { stage, holder } => (
                Verbosity::Normal,
                format!("{stage}: waiting for {holder}, which computes it"),
            ),
            Event::Warning { stage, text } => {
                (Verbosity::Quiet, format!("{stage}: warning: {text}"))
            }
            Event::Tick => return None,
        };
        (level <= self.verbosity).then_some(line)
    }

    fn said(&mut self, stage: &str, message: &Message) -> Option<String> {
        match message {
            Message::Warning(text) | Message::Remark(text) => {
                Some(format!("{stage}: warning: {text}"))
            }
            Message::Resumed {
                step,
                total,
                finished,
            } => {
                // From here the pace is counted: the steps of the earlier run took no time in this
                // one.
                self.running.insert(stage.to_owned(), Running::new(*step));
                let what = if *finished {
                    "extending its finished result"
                } else {
                    "going on"
                };
                (self.verbosity > Verbosity::Quiet)
                    .then(|| format!("{stage}: {what} from step {step} of {total}"))
            }
            _ if self.verbosity == Verbosity::Quiet => None,
            Message::Metric { name, value } => Some(format!("{stage}: {name} {}", figure(*value))),
            Message::Progress {
                step,
                total,
                values,
            } => {
                let running = self.running.get_mut(stage)?;
                if running.last.at.elapsed() < PAUSE {
                    return None;
                }
                let rate = running.pace(*step);
                // A pace of 0 has no time left that could be told, and a step beyond the total
                // would wrap around.
                let left = duration((total - step.min(total)) as f64 / rate.max(1e-9));
                let figures = figures(values);
                Some(format!(
                    "{stage}: {step}/{total}  {figures}  {} steps/s, {left} left",
                    figure(rate)
                ))
            }
        }
    }
}

impl Progress for Lines {
    fn event(&mut self, event: &Event) {
        if let Some(line) = self.line(event) {
            tell(&line);
        }
    }
}
