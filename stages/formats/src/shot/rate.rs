//! Frames a second, as a fraction: film's 23.976 is 24000/1001. Knows no frames.

use std::fmt;
use std::str::FromStr;

/// Broadcast's rates are whole ones times 1000/1001.
const BROADCAST: f64 = 1000.0 / 1001.0;
/// How near a number must be to one of those to be meant as it.
const NEAR: f64 = 1e-3;
/// Parts of a frame in which other numbers are counted.
const PARTS: u32 = 1000;
/// The fastest that is taken.
const FASTEST: f64 = 1000.0;

/// Frames a second as a fraction of whole numbers, since NTSC's rates are no decimals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rate {
    frames: u32,
    seconds: u32,
}

/// What is no rate.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no rate; write frames a second, such as 24, 23.976 or 30000/1001, at most 1000")]
pub struct RateError(String);

impl Rate {
    /// So many whole frames a second.
    pub const fn whole(frames: u32) -> Self {
        Self { frames, seconds: 1 }
    }

    /// Frames a second as one number, which 24000/1001 is only nearly.
    pub fn per_second(self) -> f64 {
        f64::from(self.frames) / f64::from(self.seconds)
    }

    /// When a frame is shown, in seconds.
    pub fn time(self, frame: usize) -> f64 {
        frame as f64 * f64::from(self.seconds) / f64::from(self.frames)
    }

    /// How long the first frames are shown together, in whole milliseconds: rounded once, so that
    /// long films keep their pace.
    pub fn milliseconds(self, frames: usize) -> u64 {
        (1000.0 * self.time(frames)).round() as u64
    }

    /// As OpenEXR holds it.
    pub fn fraction(self) -> (i32, u32) {
        // Rates that were read fit: `from_str` refuses others.
        (self.frames as i32, self.seconds)
    }

    fn of_number(number: f64) -> Self {
        // 23.976 stands for 24000/1001, which no decimal is.
        let broadcast = (number / BROADCAST).round();
        if number.fract() == 0.0 {
            return Self::whole(number as u32);
        }
        if broadcast >= 1.0 && (broadcast * BROADCAST - number).abs() < NEAR {
            return Self {
                frames: broadcast as u32 * 1000,
                seconds: 1001,
            };
        }
        Self {
            frames: (number * f64::from(PARTS)).round() as u32,
            seconds: PARTS,
        }
    }
}

impl Default for Rate {
    fn default() -> Self {
        Self::whole(24)
    }
}

impl fmt::Display for Rate {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.seconds {
            1 => write!(f, "{}", self.frames),
            seconds => write!(f, "{}/{seconds}", self.frames),
        }
    }
}

impl FromStr for Rate {
    type Err = RateError;

    fn from_str(text: &str) -> Result<Self, RateError> {
        let refuse = || RateError(text.to_owned());
        let rate = match text.split_once('/') {
            Some((frames, seconds)) => Self {
                frames: frames.trim().parse().map_err(|_| refuse())?,
                seconds: seconds.trim().parse().map_err(|_| refuse())?,
            },
            None => {
                let number: f64 = text.trim().parse().map_err(|_| refuse())?;
                if !(number > 0.0 && number <= FASTEST) {
                    return Err(refuse());
                }
                Self::of_number(number)
            }
        };
        let is_rate = rate.frames > 0
            && rate.seconds > 0
            // OpenEXR holds the numerator as a signed number of 32 bits.
            && i32::try_from(rate.frames).is_ok()
            && rate.per_second() <= FASTEST;
        is_rate.then_some(rate).ok_or_else(refuse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_read_as_people_write_them() {
        for (text, rate) in [
            ("24", "24"),
            ("23.976", "24000/1001"),
            ("29.97", "30000/1001"),
            ("59.94", "60000/1001"),
            ("12.5", "12500/1000"),
            ("30000/1001", "30000/1001"),
        ] {
            assert_eq!(
                text.parse::<Rate>().map(|rate| rate.to_string()),
                Ok(rate.to_owned())
            );
        }
        for text in [
            "",
            "0",
            "-1",
            "NaN",
            "inf",
            "24/0",
            "0/1",
            "5000",
            "4294967295/1",
            "x",
        ] {
            assert!(text.parse::<Rate>().is_err(), "{text}");
        }
    }

    #[test]
    fn long_films_keep_their_pace() {
        let rate = Rate::whole(24);
        assert_eq!(
            [1, 2, 3, 24].map(|n| rate.milliseconds(n)),
            [42, 83, 125, 1000]
        );
    }
}
