//! Progress on a terminal: one bar per running stage, and a line above the bars for whatever is
//! over.

use std::collections::BTreeMap;
use std::fmt::Write;

use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use stages::Message;

use super::lines::Lines;
use super::{Event, Progress, Verbosity, figure, figures};

/// Tells events by bars.
pub struct Bars {
    all: MultiProgress,
    running: BTreeMap<String, ProgressBar>,
    lines: Lines,
}

impl Bars {
    /// No bars yet.
    pub fn new(verbosity: Verbosity) -> Self {
        Self {
            all: MultiProgress::new(),
            running: BTreeMap::new(),
            lines: Lines::new(verbosity),
        }
    }

    fn start(&mut self, stage: &str) {
        let template = "{prefix:24} {wide_bar} {pos}/{len} {msg} {rate} steps/s, {eta} left";
        let style =
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let rate = |state: &ProgressState, out: &mut dyn Write| {
            // Bars have nobody to tell that a text could not be written.
            let _ = out.write_str(&figure(state.per_sec()));
        };
        let style = style.with_key("rate", rate);
        let bar = self.all.add(
            // How many steps there are is not known before the stage first says so.
            ProgressBar::new(0)
                .with_style(style)
                .with_prefix(stage.to_owned()),
        );
        self.running.insert(stage.to_owned(), bar);
    }

    fn stop(&mut self, stage: &str) {
        if let Some(bar) = self.running.remove(stage) {
            bar.finish_and_clear();
            self.all.remove(&bar);
        }
    }
}

impl Progress for Bars {
    fn event(&mut self, event: &Event) {
        match event {
            Event::Said {
                stage,
                message:
                    Message::Progress {
                        step,
                        total,
                        values,
                    },
            } => {
                if let Some(bar) = self.running.get(*stage) {
                    bar.set_length(*total);
                    bar.set_position(*step);
                    bar.set_message(figures(values));
                }
                return;
            }
            // Without steps a bar would stand still, and its times with it.
            Event::Tick => return self.running.values().for_each(ProgressBar::tick),
            Event::Started { stage, .. } => self.start(stage),
            Event::Finished { stage, .. }
            | Event::Failed { stage, .. }
            | Event::Stopped { stage } => self.stop(stage),
            _ => {}
        }
        if let Some(line) = self.lines.line(event) {
            // Who closed stderr does not want to be told.
            let _ = self.all.println(line);
        }
    }
}
