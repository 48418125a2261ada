//! The process, under the names that every service uses (`process_...`). Asked of the system whenever somebody reads the metrics.

use std::fmt;
use std::time::{SystemTime, UNIX_EPOCH};

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric};
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::registry::Unit;

/// What the system knows of this process.
#[derive(Debug)]
pub(super) struct Process {
    /// Seconds from the Unix epoch to when the metrics began, with the service.
    started_s: f64,
}

/// What is asked of the system.
struct Used {
    resident_bytes: u64,
    open_fds: u64,
    cpu_s: f64,
}

impl Process {
    pub(super) fn starts_now() -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Self { started_s: since.map_or(0.0, |since| since.as_secs_f64()) }
    }
}

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        let started = ConstGauge::new(self.started_s);
        let help = "When the process started, seconds since the Unix epoch";
        let at = Some(&Unit::Seconds);
        started.encode(encoder.encode_descriptor(
            "process_start_time",
            help,
            at,
            started.metric_type(),
        )?)?;
        // Elsewhere than on Linux nobody tells.
        let Some(Used { resident_bytes, open_fds, cpu_s }) = used() else { return Ok(()) };
        let cpu = ConstCounter::new(cpu_s);
        let help = "Processor time used, by user and system together";
        cpu.encode(encoder.encode_descriptor("process_cpu", help, at, cpu.metric_type())?)?;
        let resident = ConstGauge::new(resident_bytes as f64);
        let (help, bytes) = ("Memory that is resident", Some(&Unit::Bytes));
        let kind = resident.metric_type();
        resident.encode(encoder.encode_descriptor("process_resident_memory", help, bytes, kind)?)?;
        let open = ConstGauge::new(open_fds as f64);
        open.encode(encoder.encode_descriptor(
            "process_open_fds",
            "File descriptors that are open",
            None,
            open.metric_type(),
        )?)
    }
}

#[cfg(target_os = "linux")]
fn used() -> Option<Used> {
    let own = procfs::process::Process::myself().ok()?;
    let stat = own.stat().ok()?;
    Some(Used {
        resident_bytes: stat.rss.saturating_mul(procfs::page_size()),
        open_fds: own.fd_count().ok()? as u64,
        cpu_s: (stat.utime + stat.stime) as f64 / procfs::ticks_per_second() as f64,
    })
}

#[cfg(not(target_os = "linux"))]
fn used() -> Option<Used> {
    None
}
