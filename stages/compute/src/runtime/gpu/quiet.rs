//! Keeps one complaint of the system's Vulkan libraries off standard error: a layer of Mesa asks
//! Wayland which GPU shows windows, and Wayland complains where there are none (ssh, containers,
//! clusters). Nothing here has windows.

/// What the complaint is about.
const COMPLAINT: &str = "XDG_RUNTIME_DIR is invalid or not set";

/// Does something, and passes on what it says on standard error but for the complaint.
#[cfg(unix)]
pub fn quietly<T>(make: impl FnOnce() -> T) -> T {
    // Two at once would restore each other's files.
    static ONE: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let _one = ONE.lock();
    // Where standard error cannot be led elsewhere, a complaint is the lesser evil.
    let _aside = Aside::begin().ok();
    make()
}

/// Does something. Without Wayland there is no complaint to keep away.
#[cfg(not(unix))]
pub fn quietly<T>(make: impl FnOnce() -> T) -> T {
    make()
}

/// Standard error is led to a file until this is dropped.
#[cfg(unix)]
struct Aside {
    stderr: std::os::fd::OwnedFd,
    file: std::fs::File,
}

#[cfg(unix)]
impl Aside {
    fn begin() -> std::io::Result<Self> {
        use std::os::fd::AsFd;
        let stderr = std::io::stderr().as_fd().try_clone_to_owned()?;
        // A file and no pipe, which would block a talkative driver once it is full.
        let file = tempfile::tempfile()?;
        rustix::stdio::dup2_stderr(&file)?;
        Ok(Self { stderr, file })
    }

    /// What was said meanwhile, without the complaint.
    fn said(&mut self) -> std::io::Result<Vec<u8>> {
        use std::io::{Read, Seek};
        let mut said = Vec::new();
        self.file.rewind()?;
        self.file.read_to_end(&mut said)?;
        Ok(without_complaint(&said))
    }
}

#[cfg(unix)]
impl Drop for Aside {
    fn drop(&mut self) {
        use std::io::Write;
        // There is nobody to tell that standard error is lost.
        let _ = rustix::stdio::dup2_stderr(&self.stderr);
        if let Ok(said) = self.said() {
            let _ = std::io::stderr().write_all(&said);
        }
    }
}

/// The lines that are not the complaint.
#[cfg(unix)]
fn without_complaint(said: &[u8]) -> Vec<u8> {
    let lines = said.split_inclusive(|byte| *byte == b'\n');
    let kept = lines.filter(|line| !String::from_utf8_lossy(line).contains(COMPLAINT));
    kept.collect::<Vec<_>>().concat()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn all_but_the_complaint_is_passed_on() {
        let said = "one\nerror: XDG_RUNTIME_DIR is invalid or not set in the environment.\ntwo";
        assert_eq!(without_complaint(said.as_bytes()), b"one\ntwo");
        assert_eq!(quietly(|| 7), 7);
    }
}
