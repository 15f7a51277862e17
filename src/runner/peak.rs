//! The most memory that this process has while something runs, by looking again and again. Stages
//! share the process and its threads, so nobody can say whose a page is: what runs at the same time
//! is counted too. Knows no stage.

use std::fs;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

/// How long between two looks: allocations that live shorter are missed, and they are small.
const PAUSE: Duration = Duration::from_millis(20);

/// Does something, and says how many bytes the process had at most meanwhile; `None` where the
/// system does not tell.
pub fn watched<T>(work: impl FnOnce() -> T) -> (T, Option<u64>) {
    let done = AtomicBool::new(false);
    let most = AtomicU64::new(0);
    let look = || {
        if let Some(bytes) = resident() {
            // Both threads look, and the end of the scope orders their looks before the result is
            // read.
            most.fetch_max(bytes, Ordering::Relaxed);
        }
    };
    let result = thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            while !done.load(Ordering::Acquire) {
                look();
                // Parked, not asleep: the end of the work need not wait for the next look.
                thread::park_timeout(PAUSE);
            }
        });
        let result = work();
        // Once more at the end: short work would otherwise be over before the first look.
        look();
        done.store(true, Ordering::Release);
        watcher.thread().unpark();
        result
    });
    let most = most.into_inner();
    (result, (most > 0).then_some(most))
}

/// The bytes of main memory that this process has.
fn resident() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    // The kernel says kB and means 1024 bytes.
    Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_that_is_written_is_seen() {
        const SIZE: usize = 256 << 20;
        let (bytes, peak) = watched(|| vec![1u8; SIZE]);
        assert!(bytes.iter().all(|&byte| byte == 1));
        if cfg!(target_os = "linux") {
            assert!(peak.unwrap() >= SIZE as u64);
        }
    }
}
