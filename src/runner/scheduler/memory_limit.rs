//! How much memory this process may use: the machine's, or what a control group of a batch system
//! or a container leaves it. Knows nothing of stages.

use std::fs;
use std::path::Path;

/// Where control groups are, by the convention of all distributions.
const GROUPS: &str = "/sys/fs/cgroup";

/// The memory that this process may use, as far as the system says: the machine's, or less where a
/// control group sets a limit.
pub fn memory_limit() -> u64 {
    let machine = fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text
            .lines()
            .find_map(|line| line.strip_prefix("MemTotal:"))?;
        Some(line.trim().strip_suffix(" kB")?.parse::<u64>().ok()? << 10)
    });
    let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    machine
        .into_iter()
        .chain(
            groups
                .lines()
                .filter_map(|line| group_limit(line, Path::new(GROUPS))),
        )
        .min()
        // A system that does not tell must not keep any stage from running.
        .unwrap_or(u64::MAX)
}

/// The least limit of a control group and of those around it, by a line of `/proc/self/cgroup`:
/// `0::/path` of version 2, `4:memory:/path` of version 1.
fn group_limit(line: &str, root: &Path) -> Option<u64> {
    let (_, group) = line.split_once(':')?;
    let (controllers, path) = group.split_once(':')?;
    let (root, file) = match controllers {
        "" => (root.to_owned(), "memory.max"),
        _ if controllers.split(',').any(|one| one == "memory") => {
            (root.join("memory"), "memory.limit_in_bytes")
        }
        _ => return None,
    };
    let group = Path::new(path.trim_start_matches('/'));
    // A group without a limit says `max`, which is no number, or a number that no machine has. It
    // may lie in one that has a limit, as jobs of a batch system do.
    let limits = group.ancestors().filter_map(|group| {
        let text = fs::read_to_string(root.join(group).join(file)).ok()?;
        text.trim().parse::<u64>().ok()
    });
    limits.min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_says_how_much_memory_there_is() {
        assert!(memory_limit() > 64 << 20);
    }

    #[test]
    fn the_least_limit_of_a_group_and_of_those_around_it_counts() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        write("job/memory.max", "4294967296\n");
        write("job/step/memory.max", "max\n");
        write("memory/slurm/job/memory.limit_in_bytes", "2147483648\n");
        write("memory/memory.limit_in_bytes", "9223372036854771712\n");
        let limit = |line| group_limit(line, root.path());
        assert_eq!(limit("0::/job/step"), Some(4 << 30));
        assert_eq!(limit("4:memory:/slurm/job"), Some(2 << 30));
        assert_eq!(
            limit("7:cpu,memory:/elsewhere"),
            Some(9_223_372_036_854_771_712)
        );
        assert_eq!(limit("0::/"), None);
        assert_eq!(limit("9:name=systemd:/job"), None);
        assert_eq!(limit("nonsense"), None);
    }
}
