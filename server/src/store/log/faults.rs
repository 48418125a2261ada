//! Deliberate defects, so that a harness that looks for lost uploads can show that it would find them.
//!
//! Only builds with debug assertions know them; they are named by the environment variable `ECHOFIX_FAULT`.

/// A deliberate defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(not(debug_assertions), allow(dead_code, reason = "builds that serve have no faults"))]
pub(in crate::store) enum Fault {
    /// An upload is acknowledged before it is written: a crash loses it.
    AckBeforeWrite,
    /// An upload is acknowledged once it is written, but not synced: a power cut loses it.
    AckBeforeSync,
}

/// The fault this process was started with.
#[cfg(debug_assertions)]
pub(in crate::store) fn fault() -> Option<Fault> {
    static FAULT: std::sync::OnceLock<Option<Fault>> = std::sync::OnceLock::new();
    *FAULT.get_or_init(|| {
        let fault = match std::env::var("ECHOFIX_FAULT").ok()?.as_str() {
            "ack-before-write" => Fault::AckBeforeWrite,
            "ack-before-sync" => Fault::AckBeforeSync,
            _ => return None,
        };
        tracing::warn!(?fault, "this service is broken on purpose");
        Some(fault)
    })
}

/// None: builds that serve have no faults.
#[cfg(not(debug_assertions))]
pub(in crate::store) const fn fault() -> Option<Fault> {
    None
}
