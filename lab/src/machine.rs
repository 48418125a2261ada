//! The machine, and the processor time and memory of a process. Both come from `/proc`: elsewhere than on Linux they are
//! unknown.

use std::time::Duration;
use std::{fmt, fs};

use serde::Serialize;

/// The machine that figures were measured on.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// Name of the processor, as its maker gives it.
    pub processor: String,
    /// Number of cores that this process may use.
    pub cores: usize,
    /// Memory, GiB.
    pub memory_gib: f64,
}

impl Machine {
    /// The machine that this process runs on.
    pub fn here() -> Self {
        let processors = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let memory = fs::read_to_string("/proc/meminfo").unwrap_or_default();
        Self {
            processor: value_of(&processors, "model name").unwrap_or("unknown").to_owned(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory_gib: kibibytes(&memory, "MemTotal").unwrap_or(0) as f64 / f64::from(1 << 20),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} cores of {}", self.cores, self.processor)
    }
}

/// Processor time that a process has used so far, to a hundredth of a second.
pub fn used_by(process: u32) -> Option<Duration> {
    used(&fs::read_to_string(format!("/proc/{process}/stat")).ok()?)
}

/// Resident memory of a process, KiB.
pub fn held_by(process: u32) -> Option<u64> {
    kibibytes(&fs::read_to_string(format!("/proc/{process}/status")).ok()?, "VmRSS")
}

/// User and system time of `/proc/PID/stat` (`proc_pid_stat(5)`, fields 14 and 15).
fn used(stat: &str) -> Option<Duration> {
    /// One tick of `USER_HZ`, which is 100 on Linux whatever the kernel's own clock.
    const TICK: Duration = Duration::from_millis(10);
    // The second field is the program's name in brackets; it may contain blanks and brackets.
    let (_, fields) = stat.rsplit_once(')')?;
    let mut times = fields.split_whitespace().skip(11).map(str::parse::<u32>);
    let (user, system) = (times.next()?.ok()?, times.next()?.ok()?);
    Some(TICK * (user + system))
}

fn kibibytes(text: &str, key: &str) -> Option<u64> {
    value_of(text, key)?.trim_end_matches(" kB").parse().ok()
}

/// The value of the first line `key: value`.
fn value_of<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let pair = |line: &'a str| line.split_once(':').filter(|(found, _)| found.trim() == key);
    text.lines().find_map(pair).map(|(_, value)| value.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_has_cores() {
        let words = Machine::here().to_string();
        assert!(words.contains(" cores of "), "{words}");
    }

    #[test]
    fn times_are_found_behind_any_name() {
        let stat = "42 (a ) name) S 1 42 42 0 -1 4194304 100 0 0 0 250 50 0 0 20 0 3 0 100 1000 10";
        assert_eq!(used(stat), Some(Duration::from_secs(3)));
        assert_eq!(used("nonsense"), None);
    }

    #[test]
    fn values_are_found_by_their_key() {
        let text = "Name:\techofix\nVmRSS:\t  2048 kB\nmodel name\t: Some Processor\n";
        assert_eq!(kibibytes(text, "VmRSS"), Some(2048));
        assert_eq!(value_of(text, "model name"), Some("Some Processor"));
        assert_eq!(value_of(text, "VmSwap"), None);
    }
}
