//! Options that several subcommands share.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

/// Which pipeline, and with which changes.
#[derive(Args)]
pub struct PipelineOptions {
    /// The pipeline file
    #[arg(default_value = "pipelines/i3ds.ron")]
    pub pipeline: PathBuf,
    #[command(flatten)]
    pub changes: Changes,
}

/// Changes to a pipeline, and where its results lie.
#[derive(Args, Clone)]
pub struct Changes {
    /// Override one value, in RON: --set scene.downscale=2 (repeatable)
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<String>,
    /// A word in all keys: it sets a whole set of results apart
    #[arg(long)]
    pub salt: Option<String>,
    /// Where to compute: auto, cpu, gpu or gpu:N
    #[arg(long, default_value = "auto")]
    pub device: String,
    /// Where a stage goes on whose GPU fails or is too small, from its last checkpoint, under a key
    /// of its own: cpu; results that came about so count then. By default such a stage fails
    #[arg(long, value_name = "DEVICE", value_parser = ["cpu"])]
    pub fallback: Option<String>,
    /// A store that others share: s3://, gs://, az:// or file://; results are read from it, and new
    /// ones written to it
    #[arg(long, value_name = "URL")]
    pub remote: Option<String>,
    #[command(flatten)]
    pub folders: Folders,
}

/// Where results lie.
#[derive(Args, Clone)]
pub struct Folders {
    /// The folder of the store
    #[arg(long, default_value = ".srnerf", value_name = "FOLDER")]
    pub store: PathBuf,
    /// The folder in which to show results
    #[arg(long, default_value = "out", value_name = "FOLDER")]
    pub out: PathBuf,
}

/// Which stages of a pipeline.
#[derive(Args, Default)]
pub struct Choice {
    /// Only this arm of a pipeline that has arms (repeatable)
    #[arg(long, value_name = "NAME")]
    pub arm: Vec<String>,
    /// Only this stage and what it needs: i3ds.2.decode, i3ds.decode (all rounds) or i3ds
    /// (repeatable)
    #[arg(long, value_name = "STAGE")]
    pub target: Vec<String>,
    /// Compute this stage even if its result is there (repeatable)
    #[arg(long, value_name = "STAGE")]
    pub force: Vec<String>,
}

/// A time as people write it: `30s`, `5min`, `1h`, `7d`, or a number of seconds.
pub fn time(text: &str) -> Result<Duration, String> {
    let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[number.len()..] {
        "" | "s" => 1.0,
        "ms" => 0.001,
        "min" => 60.0,
        "h" => 3600.0,
        "d" => 86_400.0,
        other => {
            return Err(format!(
                "`{other}` is no unit of time; the units are ms, s, min, h and d"
            ));
        }
    };
    let seconds = number.parse::<f64>().map_err(|error| error.to_string())?;
    // Refuses what no duration can be: negative numbers, NaN and infinity.
    Duration::try_from_secs_f64(seconds * unit).map_err(|error| error.to_string())
}

/// A size as people write it: `8G`, `500MB`, `2GiB`, or a number of bytes. A unit is 1000 times the
/// one before, as in all that the program prints, and 1024 times with an `i`.
pub fn size(text: &str) -> Result<u64, String> {
    let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = text[number.len()..].trim_end_matches('B');
    let base = if unit.ends_with('i') { 1024f64 } else { 1e3 };
    let unit = unit.trim_end_matches('i').to_ascii_uppercase();
    let power = ["", "K", "M", "G", "T"]
        .iter()
        .position(|&known| known == unit);
    let power =
        power.ok_or_else(|| format!("`{unit}` is no unit of size; the units are K, M, G and T"))?;
    let bytes = number.parse::<f64>().map_err(|error| error.to_string())? * base.powi(power as i32);
    // Numbers are read as floats for the sake of `1.5G`, and so `NaN` and `inf` get this far.
    if bytes.is_finite() && bytes >= 0.0 {
        Ok(bytes as u64)
    } else {
        Err("it is no size".into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        for (text, bytes) in [
            ("0", 0),
            ("512", 512),
            ("1.5K", 1500),
            ("500MB", 500_000_000),
            ("1.5Ki", 1536),
            ("2GiB", 2 << 30),
        ] {
            assert_eq!(size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1G", "1X", "NaN"] {
            assert!(size(text).is_err(), "{text}");
        }
    }

    #[test]
    fn times_have_units() {
        for (text, seconds) in [
            ("0", 0.0),
            ("30s", 30.0),
            ("1.5min", 90.0),
            ("2h", 7200.0),
            ("250ms", 0.25),
            ("2d", 172_800.0),
        ] {
            assert_eq!(time(text), Ok(Duration::from_secs_f64(seconds)), "{text}");
        }
        for text in ["", "s", "-1s", "5 days", "1e99h", "NaN"] {
            assert!(time(text).is_err(), "{text}");
        }
    }
}
