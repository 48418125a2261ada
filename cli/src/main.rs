//! The `echofix` command.
//!
//! [`commands`] has one file a subcommand. Driving, uploading and asking are `echofix_harness`'s; experiments and
//! benchmarks are `echofix_lab`'s, and only there with the feature `lab`.

#![allow(clippy::print_stdout, reason = "printing is what a command does")]

mod commands;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// All-weather positioning with automotive radar.
#[derive(Parser)]
#[command(version, propagate_version = true, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print machine-readable JSON, and no progress bars.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Command {
    /// Watch a fleet build a radar map of a town, and other vehicles find themselves in it.
    Demo(commands::demo::Args),
    /// Run the service: gRPC for vehicles, HTTP for operators.
    Serve(commands::serve::Args),
    /// Measure on this machine what a fix costs: the whole service, its steps, its engines.
    #[cfg(feature = "lab")]
    Bench(echofix_lab::bench::command::Args),
    /// Write the drive log of a simulated vehicle.
    Simulate(commands::simulate::Args),
    /// Turn foreign radar data into a drive log.
    Import(commands::import::Args),
    /// Upload a drive log to the map; see its history, roll it back, export, import, back it up.
    Map(commands::map::Args),
    /// Replay a drive log against the service, and compare its answers with the truth.
    Localize(commands::localize::Args),
    /// Keep a copy of a region's map in a folder, as vehicles do.
    Tiles(commands::tiles::Args),
    /// Repeat the paper's experiments on simulated towns or drive logs.
    #[cfg(feature = "lab")]
    Evaluate(echofix_lab::evaluate::command::Args),
    /// Show what a running service holds and whether it is ready.
    Status(commands::status::Args),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: Cli) -> anyhow::Result<()> {
    let json = cli.json;
    match cli.command {
        Command::Serve(args) => commands::serve::run(&args),
        Command::Simulate(args) => commands::simulate::run(&args, json),
        Command::Import(args) => commands::import::run(&args, json),
        #[cfg(feature = "lab")]
        Command::Evaluate(args) => echofix_lab::evaluate::command::run(&args, json),
        Command::Status(args) => commands::status::run(&args, json),
        Command::Demo(args) => in_runtime(commands::demo::run(args, json)),
        #[cfg(feature = "lab")]
        Command::Bench(args) => in_runtime(echofix_lab::bench::command::run(args, json)),
        Command::Map(args) => in_runtime(commands::map::run(args, json)),
        Command::Tiles(args) => in_runtime(commands::tiles::run(args, json)),
        Command::Localize(args) => in_runtime(commands::localize::run(args, json)),
    }
}

fn in_runtime(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(work)
}
