//! `echofix bench`: what a fix costs on this machine.

use std::path::PathBuf;

use anyhow::Context;

use super::{BenchPlan, page, run as measure, stress, waits};
use crate::report;

/// Arguments of `echofix bench`.
#[derive(clap::Args)]
pub struct Args {
    /// Seed of the town, the drives and the priors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Use a small town and few repetitions. This shows whether the benchmark works, not what a fix costs.
    #[arg(long)]
    quick: bool,
    /// Measure a fix beside all else that the service does, and a service that is offered more than it can do.
    #[arg(long)]
    stress: bool,
    /// Measure what people wait for: the demo's first answer, the console's page, tiles, a history of 100 000 uploads.
    #[arg(long, conflicts_with = "stress")]
    waits: bool,
    /// With `--stress`: the command whose service is measured, to compare versions; this one by default.
    #[arg(long, value_name = "PATH", requires = "stress")]
    program: Option<PathBuf>,
    /// Also write the figures to docs/benchmarks/service.md in the repository at this path.
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

/// Runs the subcommand.
///
/// # Errors
/// When a step fails, or the fixes are so bad that their cost means nothing.
pub async fn run(args: Args, json: bool) -> anyhow::Result<()> {
    let Args { seed, quick, stress, waits, program, write } = args;
    let plan = if quick { BenchPlan::quick(seed) } else { BenchPlan::full(seed) };
    let folder = tempfile::tempdir().context("making a folder for the map")?;
    let say = |text: &str| {
        if !json {
            eprintln!("{text}");
        }
    };
    let quick = if quick { " --quick" } else { "" };
    let (section, page, figures) = if stress {
        let program = program.map_or_else(std::env::current_exe, Ok)?;
        let subject = stress::Subject { program, folder: folder.path() };
        let figures = stress::run(&plan, &subject, &say).await?;
        let command = format!("echofix bench --stress{quick} --seed {seed}");
        ("stress", stress::page(&figures, &command), serde_json::to_string(&figures)?)
    } else if waits {
        let program = std::env::current_exe()?;
        let figures = waits::run(&plan, (&program, folder.path()), &say).await?;
        let command = format!("echofix bench --waits{quick} --seed {seed}");
        ("waits", waits::page(&figures, &command), serde_json::to_string(&figures)?)
    } else {
        let figures = measure(plan, folder.path(), &say).await?;
        let command = format!("echofix bench{quick} --seed {seed}");
        ("bench", page(&figures, &command), serde_json::to_string(&figures)?)
    };
    if let Some(repository) = write {
        report::write_section(&report::pages(&repository)?.join("service.md"), section, &page)?;
    }
    if json {
        println!("{figures}");
    } else {
        println!("{page}");
    }
    Ok(())
}
