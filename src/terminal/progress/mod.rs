//! What happens during a run, told as it happens. Each way of telling is a file: bars, lines, JSON.

pub mod bars;
pub mod json;
pub mod lines;
pub mod tev;

use std::io::IsTerminal;

use artifacts_schema::Digest;
use stages::Message;

use crate::store::leases::holder::Holder;
use crate::store::record::Record;

/// Something that happened.
pub enum Event<'a> {
    /// The results of stages were there.
    Cached {
        /// The stages and their keys.
        results: &'a [(&'a str, Digest)],
    },
    /// A stage's result came from the remote.
    Fetched {
        stage: &'a str,
        key: Digest,
        /// How many bytes came.
        bytes: u64,
    },
    /// A stage began.
    Started {
        stage: &'a str,
        key: Digest,
        /// Why it runs.
        reason: &'a str,
    },
    /// A stage said something.
    Said {
        stage: &'a str,
        /// What it said.
        message: &'a Message,
    },
    /// A stage's result is committed.
    Finished {
        stage: &'a str,
        /// How long it took.
        seconds: f64,
        /// The result.
        record: &'a Record,
    },
    /// A stage failed.
    Failed {
        stage: &'a str,
        error: &'a str,
        /// The arms that it is part of, which fail with it.
        arms: &'a [&'a str],
    },
    /// A stage was stopped half-way.
    Stopped { stage: &'a str },
    /// A stage will not run since another failed.
    Blocked {
        stage: &'a str,
        /// The one that failed.
        by: &'a str,
    },
    /// Another process computes a stage; its result will be used.
    Waiting {
        stage: &'a str,
        /// The process.
        holder: &'a Holder,
    },
    /// Something is not as the user might expect.
    Warning { stage: &'a str, text: &'a str },
    /// Something about the whole run is not as the user might expect.
    Notice { text: &'a str },
    /// A moment passed.
    Tick,
}

/// Tells what happens.
pub trait Progress: Send {
    /// Tells one event.
    fn event(&mut self, event: &Event);
}

/// How much to tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Warnings and errors.
    Quiet,
    /// Also what runs, and why.
    Normal,
    /// Also keys and digests.
    Verbose,
}

/// The way of telling that suits where the output goes.
pub fn choose(json: bool, verbosity: Verbosity, bars: bool) -> Box<dyn Progress> {
    if json {
        Box::new(json::Json::default())
    // Bars need a terminal, which can go back over what it shows.
    } else if bars && verbosity > Verbosity::Quiet && std::io::stderr().is_terminal() {
        Box::new(bars::Bars::new(verbosity))
    } else {
        Box::new(lines::Lines::new(verbosity))
    }
}

/// Seconds as people say them: `8.2 s`, `3 min 20 s`, `1 h 05 min`.
pub fn duration(seconds: f64) -> String {
    // Rounded first, so that 59.7 becomes `1 min 00 s` and not `60 s`.
    let whole = seconds.round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

/// Named figures: `loss 0.0123 psnr 24.1`.
pub fn figures(values: &[(&'static str, f64)]) -> String {
    values
        .iter()
        .map(|(name, value)| format!("{name} {}", figure(*value)))
        .collect::<Vec<_>>()
        .join(" ")
}

/// A number with four significant digits.
pub fn figure(value: f64) -> String {
    match value.abs() {
        size if size == 0.0 || (1e-3..1e5).contains(&size) => {
            // The logarithm of 0 is infinite.
            let digits = (3.0 - size.max(1e-3).log10().floor()).clamp(0.0, 6.0);
            format!("{value:.*}", digits as usize)
        }
        _ => format!("{value:.2e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!(figure(24.1234), "24.12");
        assert_eq!(figure(0.012345), "0.01235");
        assert_eq!(figure(1.5e-7), "1.50e-7");
        assert_eq!(figure(0.0), "0.000000");
        assert_eq!(duration(8.24), "8.2 s");
        assert_eq!(duration(200.0), "3 min 20 s");
        assert_eq!(duration(3900.0), "1 h 05 min");
    }
}
