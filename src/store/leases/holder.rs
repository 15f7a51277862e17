//! A process that holds a lease: where it runs, and whether it still does. Knows nothing of leases.

use std::fmt;
use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

/// Where the system shows its processes.
const PROC: &str = "/proc";

/// A process. What cannot be known is left empty.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Holder {
    /// The host's name.
    pub host: String,
    /// The process's number.
    pub pid: u32,
    /// What tells the host's boots, and on one host the spaces of process numbers (of containers),
    /// from each other.
    pub boot: String,
    /// When the process began, in ticks since the boot: numbers are used again, these pairs are
    /// not.
    pub started: String,
    /// The cluster's number of the job, if it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub job: Option<String>,
}

impl Holder {
    /// The process that we are.
    pub fn this_process() -> &'static Self {
        static THIS: LazyLock<Holder> = LazyLock::new(|| {
            let pid = std::process::id();
            Holder {
                host: read("/proc/sys/kernel/hostname")
                    .or_else(|| std::env::var("HOSTNAME").ok())
                    .unwrap_or_default(),
                pid,
                boot: boot().unwrap_or_default(),
                started: Life::of(pid, Path::new(PROC)).started().unwrap_or_default(),
                job: std::env::var("SLURM_JOB_ID").ok(),
            }
        });
        &THIS
    }

    /// Whether the process is certainly over. Of a process elsewhere nothing is certain.
    pub fn is_dead(&self) -> bool {
        // Only in the same boot and the same space of process numbers does a number say anything.
        let here = !self.boot.is_empty() && self.boot == Self::this_process().boot;
        here && !self.started.is_empty() && self.is_over(Path::new(PROC))
    }

    fn is_over(&self, proc: &Path) -> bool {
        match Life::of(self.pid, proc) {
            Life::Since(started) => started != self.started,
            Life::Over => true,
            Life::Hidden => false,
        }
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.host.is_empty() {
            return f.write_str("another process");
        }
        write!(f, "process {} on {}", self.pid, self.host)?;
        self.job
            .iter()
            .try_for_each(|job| write!(f, " (job {job})"))
    }
}

/// This boot and this space of process numbers.
fn boot() -> Option<String> {
    // Containers share the kernel and its boot, but each counts its processes from 1.
    let space = fs::read_link("/proc/self/ns/pid").ok()?;
    Some(format!(
        "{} {}",
        read("/proc/sys/kernel/random/boot_id")?,
        space.to_str()?
    ))
}

/// What can be said of a process number.
enum Life {
    /// The process that has it lives, and began then.
    Since(String),
    /// No living process has it.
    Over,
    /// A process has it, and which one is not shown to us.
    Hidden,
}

impl Life {
    fn of(pid: u32, proc: &Path) -> Self {
        match fs::read_to_string(proc.join(pid.to_string()).join("stat")) {
            Ok(stat) => started(&stat).map_or(Self::Over, Self::Since),
            // A cluster may show its users their own processes alone (proc's option `hidepid`).
            Err(_) if exists(pid) => Self::Hidden,
            Err(_) => Self::Over,
        }
    }

    fn started(self) -> Option<String> {
        match self {
            Self::Since(started) => Some(started),
            Self::Over | Self::Hidden => None,
        }
    }
}

/// When a living process began. Field 22 of its `stat`; the second is a name in parentheses, the
/// third its state.
fn started(stat: &str) -> Option<String> {
    // From the last parenthesis on: a process can have one in its name.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    // A process that nobody has waited for is still listed, and runs no more.
    let over = matches!(*fields.first()?, "Z" | "X");
    // The third field is the first here, so the 22nd has the index 19.
    (!over).then(|| fields.get(19).map(ToString::to_string))?
}

/// Whether any process has this number, shown or not.
#[cfg(unix)]
fn exists(pid: u32) -> bool {
    use rustix::process::{Pid, test_kill_process};
    // Asks whether it could be sent a signal, and sends none. That we may not is a sign of life.
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) != Err(rustix::io::Errno::SRCH))
}

#[cfg(not(unix))]
fn exists(_: u32) -> bool {
    true
}

fn read(path: &str) -> Option<String> {
    fs::read_to_string(path)
        .ok()
        .map(|text| text.trim().to_owned())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_living_are_told_from_the_dead() {
        let life = |pid| Life::of(pid, Path::new(PROC)).started();
        let me = Holder::this_process().clone();
        assert!(!me.is_dead() && !me.host.is_empty());
        let mut child = std::process::Command::new("sleep")
            .arg("60")
            .spawn()
            .unwrap();
        let other = Holder {
            pid: child.id(),
            started: life(child.id()).unwrap(),
            ..me.clone()
        };
        assert!(!other.is_dead());
        child.kill().unwrap();
        // Nobody has asked for its end yet: it is over all the same.
        while life(child.id()).is_some() {
            std::thread::yield_now();
        }
        assert!(other.is_dead());
        child.wait().unwrap();
        assert!(other.is_dead());
        assert!(
            Holder {
                started: "1".into(),
                ..me.clone()
            }
            .is_dead(),
            "another with the same number"
        );
        assert!(
            !Holder {
                boot: "elsewhere".into(),
                ..other
            }
            .is_dead(),
            "who knows"
        );
        assert!(!Holder::default().is_dead());
    }

    #[test]
    fn who_is_not_shown_is_not_dead_as_long_as_the_number_is_taken() {
        let hides = tempfile::tempdir().unwrap();
        let me = Holder::this_process();
        assert!(!me.is_over(hides.path()));
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let pid = child.id();
        child.wait().unwrap();
        let gone = Holder { pid, ..me.clone() };
        assert!(gone.is_over(hides.path()));
    }
}
