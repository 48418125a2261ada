//! When to end.

use std::future::poll_fn;
use std::io;
use std::task::Poll;

use tokio::signal::unix::{Signal, SignalKind, signal};

/// Listens, from this call on, for what asks the process to end: SIGTERM, ctrl-c, and SIGHUP, with which a terminal goes. Nothing
/// is read anew on SIGHUP: the service looks at its files by itself. One that was started with `nohup` stays.
///
/// Call it within a runtime and first of all: until then a signal kills, or, in a container's first process, is ignored.
///
/// # Errors
/// When the system does not let the process listen.
pub fn signalled() -> io::Result<impl Future<Output = ()> + Send> {
    let mut kinds = vec![SignalKind::terminate(), SignalKind::interrupt()];
    if !is_ignored(SignalKind::hangup()) {
        kinds.push(SignalKind::hangup());
    }
    let mut signals = kinds.into_iter().map(signal).collect::<io::Result<Vec<Signal>>>()?;
    Ok(poll_fn(move |context| {
        let any = signals.iter_mut().any(|signal| signal.poll_recv(context).is_ready());
        if any { Poll::Ready(()) } else { Poll::Pending }
    }))
}

/// Does the process ignore a signal already? Where the system does not say, it does not.
fn is_ignored(kind: SignalKind) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (kind.as_raw_value() - 1) & 1 == 1
}
