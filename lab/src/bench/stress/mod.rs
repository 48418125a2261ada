//! `echofix bench --stress`: a fix while the service does everything else, and a service that is offered more than it can do.
//!
//! - [`beside`]: the same questions alone, and beside uploads, folding, vetting, rendering and verifying.
//! - [`overload`]: an open loop at multiples of the capacity.
//! - [`raw`]: requests that were encoded before, so that asking costs little.
//! - [`mod@page`]: the figures as a page.
//!
//! Service and clients share the machine. Those that are to disturb it yield to all others, so that what is measured is the
//! service and not how many programs a core can take.

mod beside;
mod overload;
mod page;
mod raw;

use std::path::{Path, PathBuf};

use echofix_harness::process::{Launch, ServiceProcess};
use serde::Serialize;

use super::BenchPlan;
use super::town::{BenchTown, TRUSTING};
use crate::machine::Machine;
use beside::Beside;
use overload::Offered;
pub(super) use page::page;

/// What was measured.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Stress {
    pub(super) machine: Machine,
    pub(super) seed: u64,
    pub(super) beside: Beside,
    /// Kilobytes of a request that the overload consists of.
    pub(super) request_kb: f64,
    /// Answers a second when clients wait for them.
    pub(super) capacity_per_s: f64,
    pub(super) offered: Vec<Offered>,
}

/// How the service that is put under stress is started.
pub(super) struct Subject<'a> {
    /// The command; this one, unless another version is to be compared.
    pub(super) program: PathBuf,
    pub(super) folder: &'a Path,
}

impl Subject<'_> {
    async fn start(&self) -> anyhow::Result<ServiceProcess> {
        ServiceProcess::started(&Launch {
            program: &self.program,
            folder: self.folder,
            data_dir: &self.folder.join("data"),
            settings: vec![TRUSTING.to_owned()],
            variables: Vec::new(),
        })
        .await
    }
}

/// Measures with a town of its own.
///
/// # Errors
/// When a step fails.
pub(super) async fn run(
    plan: &BenchPlan,
    subject: &Subject<'_>,
    say: &impl Fn(&str),
) -> anyhow::Result<Stress> {
    say("A town is mapped.");
    let town = BenchTown::mapped(plan, subject.folder).await?;
    say("A fix alone, and beside all else.");
    let beside = beside::measure(plan, subject, &town).await?;
    say("More than the service can do.");
    let (request_kb, capacity_per_s, offered) = overload::measure(plan, subject, &town).await?;
    Ok(Stress { machine: Machine::here(), seed: plan.seed, beside, request_kb, capacity_per_s, offered })
}
