//! What is known of a run at this moment, and its changes for whoever looks. Knows nothing of HTTP.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};
use stages::Message;
use tokio::sync::broadcast::{self, Receiver, Sender};

use crate::terminal::progress::Event;

/// Points of a curve at most; one of more is thinned out.
const MOST_POINTS: usize = 240;
/// How long to wait between two messages about one stage, unless its state has changed.
const PAUSE: Duration = Duration::from_millis(250);
/// Changes that a slow page may lag behind before it gets the whole dashboard anew.
const LAG: usize = 512;

/// Where a stage stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StageState {
    /// Its inputs are not there yet, or its turn has not come.
    #[default]
    Waiting,
    /// Its result was there.
    Cached,
    /// It computes.
    Running,
    /// Its result is committed.
    Done,
    /// It ended with an error.
    Failed,
    /// It was interrupted, and goes on in the next run.
    Stopped,
    /// It will not run, since another has failed.
    Blocked,
}

/// What is known of a stage.
#[derive(Debug, Default, Serialize)]
struct Card {
    state: StageState,
    /// Why it runs, or what went wrong.
    why: String,
    step: u64,
    total: u64,
    /// How long it took, once it is done.
    seconds: Option<f64>,
    /// Figures by name: step and value.
    curves: BTreeMap<&'static str, Vec<(u64, f64)>>,
    /// What the user should know.
    warnings: Vec<String>,
    /// When it last changed for those who look.
    #[serde(skip)]
    shown: Option<Instant>,
}

pub struct Dashboard {
    pipeline: String,
    /// In the order of the pipeline.
    names: Vec<String>,
    cards: Mutex<BTreeMap<String, Card>>,
    changes: Sender<String>,
}

impl Dashboard {
    /// A dashboard of a pipeline's stages, all of which wait.
    pub fn new(pipeline: &str, names: Vec<String>) -> Self {
        let cards = names.iter().map(|name| (name.clone(), Card::default()));
        Self {
            pipeline: pipeline.to_owned(),
            cards: Mutex::new(cards.collect()),
            names,
            // A page that does not read must not hold up the run: what it misses is dropped.
            changes: broadcast::channel(LAG).0,
        }
    }

    /// Whether there is a stage of this name.
    pub fn has(&self, stage: &str) -> bool {
        self.names.iter().any(|name| name == stage)
    }

    /// How many pages look.
    pub fn watchers(&self) -> usize {
        self.changes.receiver_count()
    }

    /// All of it as it is now, and all changes from now on.
    pub fn look(&self) -> (String, Receiver<String>) {
        let cards = self.cards.lock();
        // Under the lock, so that no change falls between.
        let changes = self.changes.subscribe();
        let cards = cards.as_deref().ok().map(|cards| json!(cards));
        let whole = json!({"pipeline": self.pipeline, "names": self.names, "stages": cards});
        (whole.to_string(), changes)
    }

    /// Says that the run is over, in a sentence.
    pub fn end(&self, text: &str) {
        self.tell(&json!({ "ended": text }));
    }

    /// Notes what happened.
    pub fn note(&self, event: &Event) {
        match *event {
            Event::Cached { results } => {
                for (stage, _) in results {
                    self.turn(stage, StageState::Cached, "");
                }
            }
            Event::Fetched { stage, .. } => self.turn(stage, StageState::Cached, "fetched"),
            Event::Started { stage, reason, .. } => self.turn(stage, StageState::Running, reason),
            Event::Said { stage, message } => self.said(stage, message),
            Event::Finished { stage, seconds, .. } => self.change(stage, true, |card| {
                card.state = StageState::Done;
                card.seconds = Some(seconds);
            }),
            Event::Failed { stage, error, .. } => self.turn(stage, StageState::Failed, error),
            Event::Stopped { stage } => self.turn(stage, StageState::Stopped, ""),
            Event::Blocked { stage, by } => {
                self.turn(stage, StageState::Blocked, &format!("`{by}` has failed"));
            }
            Event::Waiting { stage, .. } => {
                self.turn(stage, StageState::Waiting, "another process computes it");
            }
            Event::Warning { stage, text } => self.warn(stage, text),
            // Neither is of one stage, and the page shows stages.
            Event::Notice { .. } | Event::Tick => {}
        }
    }

    fn turn(&self, stage: &str, state: StageState, why: &str) {
        self.change(stage, true, |card| {
            card.state = state;
            why.clone_into(&mut card.why);
        });
    }

    fn warn(&self, stage: &str, text: &str) {
        self.change(stage, true, |card| card.warnings.push(text.to_owned()));
    }

    fn said(&self, stage: &str, message: &Message) {
        match message {
            Message::Progress {
                step,
                total,
                values,
            } => self.change(stage, false, |card| {
                card.step = *step;
                card.total = *total;
                for (name, value) in values {
                    add(card.curves.entry(name).or_default(), *step, *value);
                }
            }),
            Message::Warning(text) | Message::Remark(text) => self.warn(stage, text),
            Message::Resumed { .. } | Message::Metric { .. } => {}
        }
    }

    /// Changes a card, and tells those who look: `at_once`, or if it is long enough ago that they
    /// were told of it.
    fn change(&self, stage: &str, at_once: bool, change: impl FnOnce(&mut Card)) {
        let Ok(mut cards) = self.cards.lock() else {
            return;
        };
        let Some(card) = cards.get_mut(stage) else {
            return;
        };
        change(card);
        let now = Instant::now();
        let long_ago = |shown: Instant| now.duration_since(shown) >= PAUSE;
        // Stages take hundreds of steps a second. A change of state is never held back.
        if at_once || card.shown.is_none_or(long_ago) {
            card.shown = Some(now);
            self.tell(&json!({"stages": {stage: card}}));
        }
    }

    fn tell(&self, change: &Value) {
        // Nobody may look.
        let _ = self.changes.send(change.to_string());
    }
}

/// Adds a point to a curve; every second one is dropped when there are too many.
fn add(curve: &mut Vec<(u64, f64)>, step: u64, value: f64) {
    // A training has hundreds of thousands of steps, and every page gets the whole curve with each
    // change.
    if curve.len() >= MOST_POINTS {
        let mut at = 0;
        curve.retain(|_| {
            at += 1;
            at % 2 == 1
        });
    }
    // After thinning, points come as far apart as those that were kept.
    let apart = match curve.as_slice() {
        [.., (a, _), (b, _)] => (b - a).max(1),
        _ => 1,
    };
    if curve.last().is_none_or(|(last, _)| step >= last + apart) {
        curve.push((step, value));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dashboard() -> Dashboard {
        Dashboard::new("p", vec!["fit".to_owned(), "render".to_owned()])
    }

    fn progress(step: u64) -> Message {
        Message::Progress {
            step,
            total: 9,
            values: vec![("loss", 1.0 / step as f64)],
        }
    }

    #[test]
    fn whoever_looks_gets_all_there_is_and_then_what_changes() {
        let dashboard = dashboard();
        let begin = Event::Started {
            stage: "fit",
            key: artifacts_schema::Digest::new([0; 32]),
            reason: "new",
        };
        dashboard.note(&begin);
        let (whole, mut changes) = dashboard.look();
        let whole: Value = serde_json::from_str(&whole).unwrap();
        assert_eq!(whole["names"], json!(["fit", "render"]));
        assert_eq!(whole["stages"]["fit"]["state"], "running");
        assert_eq!(whole["stages"]["render"]["state"], "waiting");
        assert_eq!(dashboard.watchers(), 1);
        dashboard.note(&Event::Failed {
            stage: "fit",
            error: "too hot",
            arms: &[],
        });
        let change: Value = serde_json::from_str(&changes.try_recv().unwrap()).unwrap();
        assert_eq!(change["stages"]["fit"]["state"], "failed");
        assert_eq!(change["stages"]["fit"]["why"], "too hot");
    }

    #[test]
    fn steps_in_quick_succession_are_one_change() {
        let dashboard = dashboard();
        let (_, mut changes) = dashboard.look();
        for step in 1..=9 {
            dashboard.note(&Event::Said {
                stage: "fit",
                message: &progress(step),
            });
        }
        assert!(changes.try_recv().is_ok());
        let whole: Value = serde_json::from_str(&dashboard.look().0).unwrap();
        assert_eq!(whole["stages"]["fit"]["step"], 9, "none is forgotten");
        assert_eq!(
            whole["stages"]["fit"]["curves"]["loss"][8],
            json!([9, 1.0 / 9.0])
        );
    }

    #[test]
    fn a_long_curve_is_thinned_out_evenly() {
        let mut curve = Vec::new();
        (0..100_000).for_each(|step| add(&mut curve, step, 0.0));
        assert!((MOST_POINTS / 2..=MOST_POINTS).contains(&curve.len()));
        let apart: Vec<u64> = curve.windows(2).map(|two| two[1].0 - two[0].0).collect();
        assert!(apart.iter().all(|gap| *gap == apart[0]), "{apart:?}");
        assert!(curve.last().unwrap().0 > 99_000);
    }
}
