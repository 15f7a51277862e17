//! Progress for programs: one JSON object a line on stdout. `docs/cli.md` lists them.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use artifacts_schema::Digest;
use serde_json::{Value, json};
use stages::Message;

use super::{Event, Progress};
use crate::terminal::output::print;

/// The shortest time between two progress messages of one stage.
const PAUSE: Duration = Duration::from_millis(500);

/// Tells events as JSON.
#[derive(Default)]
pub struct Json {
    last: BTreeMap<String, Instant>,
}

impl Json {
    fn value(&mut self, event: &Event) -> Option<Value> {
        Some(match event {
            Event::Fetched { stage, key, bytes } => {
                json!({"event": "fetched", "stage": stage, "key": key, "bytes": bytes})
            }
            Event::Notice { text } => json!({"event": "notice", "text": text}),
            Event::Started { stage, key, reason } => {
                json!({"event": "started", "stage": stage, "key": key, "reason": reason})
            }
            Event::Finished {
                stage,
                seconds,
                record,
            } => {
                let outputs: BTreeMap<_, _> = record
                    .outputs
                    .iter()
                    .map(|(name, output)| (name, output.digest))
                    .collect();
                json!({"event": "stage_finished", "stage": stage, "key": record.key, "seconds": seconds, "outputs": outputs})
            }
            Event::Failed { stage, error, arms } => {
                json!({"event": "failed", "stage": stage, "error": error, "arms": arms})
            }
            Event::Stopped { stage } => json!({"event": "stopped", "stage": stage}),
            Event::Blocked { stage, by } => json!({"event": "blocked", "stage": stage, "by": by}),
            Event::Waiting { stage, holder } => {
                json!({"event": "waiting", "stage": stage, "holder": holder})
            }
            Event::Warning { stage, text } => {
                json!({"event": "warning", "stage": stage, "text": text})
            }
            Event::Said { stage, message } => return self.said(stage, message),
            // Cached results are printed by `event`, and a tick is for bars.
            Event::Cached { .. } | Event::Tick => return None,
        })
    }

    fn said(&mut self, stage: &str, message: &Message) -> Option<Value> {
        match message {
            Message::Warning(text) | Message::Remark(text) => {
                Some(json!({"event": "warning", "stage": stage, "text": text}))
            }
            Message::Resumed {
                step,
                total,
                finished,
            } => {
                let of = if *finished { "result" } else { "checkpoint" };
                Some(
                    json!({"event": "resumed", "stage": stage, "step": step, "total": total, "from": of}),
                )
            }
            Message::Metric { name, value } => {
                Some(json!({"event": "metric", "stage": stage, "name": name, "value": value}))
            }
            Message::Progress {
                step,
                total,
                values,
            } => {
                let due = self
                    .last
                    .get(stage)
                    .is_none_or(|last| last.elapsed() >= PAUSE);
                // The last step is always told: who reads this waits for it.
                if !due && step < total {
                    return None;
                }
                self.last.insert(stage.to_owned(), Instant::now());
                let values: BTreeMap<_, _> = values.iter().copied().collect();
                Some(
                    json!({"event": "progress", "stage": stage, "step": step, "total": total, "values": values}),
                )
            }
        }
    }
}

impl Progress for Json {
    fn event(&mut self, event: &Event) {
        if let Event::Cached { results } = event {
            let line = |(stage, key): &(&str, Digest)| {
                json!({"event": "cached", "stage": stage, "key": key}).to_string()
            };
            // In one go: thousands of lines are written faster so.
            print(&results.iter().map(line).collect::<Vec<_>>().join("\n"));
        } else if let Some(value) = self.value(event) {
            print(&value);
        }
    }
}
