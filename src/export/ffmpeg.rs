//! Moving pictures by the `ffmpeg` that is on the PATH. Pictures go to its standard input, and no
//! shell comes between. Knows no image sets.

use std::ffi::OsString;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};

use artifacts_schema::Picture;
use formats::shot::Rate;

/// Of what ffmpeg says the last lines are shown.
const LINES: usize = 4;

/// How a film is coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// H.264 in an MP4.
    H264,
    /// VP9 in a WebM.
    Vp9,
}

impl Codec {
    /// The loss that is hardly seen.
    pub fn usual_crf(self) -> u32 {
        match self {
            Self::H264 => 16,
            Self::Vp9 => 24,
        }
    }

    fn options(self) -> &'static [&'static str] {
        match self {
            Self::H264 => &[
                "-c:v",
                "libx264",
                "-preset",
                "slow",
                // The index stands at the front, so that a browser can play before all is there.
                "-movflags",
                "+faststart",
                "-f",
                "mp4",
            ],
            Self::Vp9 => &[
                "-c:v",
                "libvpx-vp9",
                // With a bitrate of 0, VP9 keeps to the CRF alone.
                "-b:v",
                "0",
                "-row-mt",
                "1",
                "-f",
                "webm",
            ],
        }
    }
}

/// What sRGB's numbers are, told to players: Rec.709's primaries and matrix, sRGB's own curve. Sides
/// are cut to even ones, since colours have half the resolution.
const COLORS: [&str; 8] = [
    "-vf",
    "crop=trunc(iw/2)*2:trunc(ih/2)*2,scale=out_color_matrix=bt709:out_range=tv,format=yuv420p",
    "-color_primaries",
    "bt709",
    "-color_trc",
    "iec61966-2-1",
    "-colorspace",
    "bt709",
];

/// Why there is no film.
#[derive(Debug, thiserror::Error)]
pub enum FfmpegError {
    /// No such program.
    #[error("there is no `ffmpeg` on the PATH")]
    Missing,
    /// It is there, and does not start or listen.
    #[error("`ffmpeg` cannot be used: {0}")]
    Broken(#[from] std::io::Error),
    #[error("`ffmpeg` gave up ({status}): {said}")]
    GaveUp {
        /// How it ended.
        status: ExitStatus,
        /// The end of what it said.
        said: String,
    },
}

/// How a film is written.
pub struct Ffmpeg {
    /// Its code.
    pub codec: Codec,
    /// Its pace.
    pub rate: Rate,
    /// How much is lost.
    pub crf: u32,
}

impl Ffmpeg {
    /// Writes pictures, at least one and all of one size, to a file.
    pub fn write(&self, pictures: &[Picture], path: &Path) -> Result<(), FfmpegError> {
        let [width, height] = pictures
            .first()
            .map_or([0; 2], |one| [one.width, one.height]);
        let mut ffmpeg = Command::new("ffmpeg")
            .args(self.arguments(width, height))
            .arg(file(path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| match error.kind() {
                std::io::ErrorKind::NotFound => FfmpegError::Missing,
                _ => FfmpegError::Broken(error),
            })?;
        let fed = Fed::of(&mut ffmpeg, pictures)?;
        let status = ffmpeg.wait()?;
        if !status.success() {
            // What ffmpeg says comes before what became of the pipe, which only says that it broke.
            let said = last_lines(&fed.said);
            return Err(FfmpegError::GaveUp { status, said });
        }
        // One that ends well has read all that there was.
        Ok(fed.taken?)
    }

    fn arguments(&self, width: u32, height: u32) -> Vec<String> {
        let words = |words: &[&str]| {
            words
                .iter()
                .map(|word| (*word).to_owned())
                .collect::<Vec<_>>()
        };
        let mut all = words(&["-hide_banner", "-nostdin", "-loglevel", "error", "-y"]);
        all.extend(words(&[
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-video_size",
        ]));
        all.push(format!("{width}x{height}"));
        all.extend(words(&[
            "-framerate",
            &self.rate.to_string(),
            "-i",
            "pipe:0",
            "-an",
        ]));
        all.extend(words(&COLORS));
        all.extend(words(&["-crf", &self.crf.to_string()]));
        // Nothing of the clock and of the version goes into the file.
        all.extend(words(&[
            "-fflags",
            "+bitexact",
            "-flags:v",
            "+bitexact",
            "-map_metadata",
            "-1",
        ]));
        all.extend(words(self.codec.options()));
        all
    }
}

/// What became of giving it all pictures.
struct Fed {
    /// Whether it took them.
    taken: std::io::Result<()>,
    /// What it said meanwhile: unread, a full pipe would stop it.
    said: String,
}

impl Fed {
    fn of(ffmpeg: &mut Child, pictures: &[Picture]) -> std::io::Result<Self> {
        let stdin = ffmpeg.stdin.take();
        std::thread::scope(|scope| {
            // Both pipes at once: a pipe full of messages would stop ffmpeg, which then takes no
            // pictures.
            let writer = scope.spawn(move || {
                let mut stdin = stdin.ok_or_else(|| std::io::Error::other("it has no input"))?;
                // The pipe closes when this thread is done, which tells ffmpeg that there are no
                // more pictures.
                let mut pictures = pictures.iter();
                pictures.try_for_each(|picture| stdin.write_all(&picture.rgb8))
            });
            let mut said = Vec::new();
            if let Some(stderr) = &mut ffmpeg.stderr {
                stderr.read_to_end(&mut said)?;
            }
            let broke = |_| Err(std::io::Error::other("its input broke"));
            Ok(Self {
                taken: writer.join().unwrap_or_else(broke),
                said: String::from_utf8_lossy(&said).into_owned(),
            })
        })
    }
}

/// A path that is not taken for an option, nor for a protocol.
fn file(path: &Path) -> OsString {
    let mut word = OsString::from("file:");
    word.push(path);
    word
}

fn last_lines(said: &str) -> String {
    let lines: Vec<&str> = said
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .collect();
    match lines.len() {
        0 => "it said nothing".to_owned(),
        all => lines[all.saturating_sub(LINES)..].join("; "),
    }
}
