//! `echofix bench`: what a fix costs on this machine.

use std::path::PathBuf;

use anyhow::Context;

use super::{BenchPlan, page, run as measure};
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
    /// Also write the figures to docs/benchmarks/service.md in the repository at this path.
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

/// Runs the subcommand.
///
/// # Errors
/// When a step fails, or the fixes are so bad that their cost means nothing.
pub async fn run(args: Args, json: bool) -> anyhow::Result<()> {
    let Args { seed, quick, write } = args;
    let plan = if quick { BenchPlan::quick(seed) } else { BenchPlan::full(seed) };
    let folder = tempfile::tempdir().context("making a folder for the map")?;
    let say = |text: &str| {
        if !json {
            eprintln!("{text}");
        }
    };
    let figures = measure(plan, folder.path(), &say).await?;
    let quick = if quick { " --quick" } else { "" };
    let page = page(&figures, &format!("echofix bench{quick} --seed {seed}"));
    if let Some(repository) = write {
        report::write_section(&report::pages(&repository)?.join("service.md"), "bench", &page)?;
    }
    if json {
        println!("{}", serde_json::to_string(&figures)?);
    } else {
        println!("{page}");
    }
    Ok(())
}
