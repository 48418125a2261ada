//! The `echofix` command.
//!
//! [`commands`] has one file for each subcommand. Drives, uploads and requests come from `echofix_harness`. Experiments and
//! benchmarks come from `echofix_lab`; they are compiled in with the feature `lab`.

#![allow(clippy::print_stdout, reason = "printing is what a command does")]

mod commands;
mod offline;
mod readers;
mod unfinished;

use std::process::ExitCode;

use anyhow::Context;
use clap::{CommandFactory, Parser, Subcommand};
use echofix_harness::credentials::Credentials;
use echofix_harness::progress;

/// The version, and the commit that it was built from.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("ECHOFIX_BUILT_FROM"), ")");

/// All-weather positioning with automotive radar.
#[derive(Parser)]
#[command(version = VERSION, propagate_version = true, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print JSON for machines, without progress bars.
    #[arg(long, global = true)]
    json: bool,
    #[command(flatten)]
    credentials: Credentials,
}

#[derive(Subcommand)]
enum Command {
    /// Simulate a fleet that maps a town, and another vehicle that localizes itself on this map.
    Demo(commands::demo::Args),
    /// Run the service: gRPC for vehicles, HTTP for operators.
    Serve(commands::serve::Args),
    /// Measure what a fix costs on this machine: under load, step by step, and engine by engine.
    #[cfg(feature = "lab")]
    Bench(echofix_lab::bench::command::Args),
    /// Simulate what a fleet asks of several replicas: cores, memory, requests to the bucket, dollars.
    #[cfg(feature = "lab")]
    Sizing(echofix_lab::sizing::command::Args),
    /// Write the drive log of a simulated vehicle.
    Simulate(commands::simulate::Args),
    /// Convert the radar data of a public data set to a drive log.
    Import(commands::import::Args),
    /// Upload drive logs to the map; show its history, exclude uploads, export, import, check and back it up.
    Map(commands::map::Args),
    /// Send the batches of a drive log to the service, and compare its fixes with the known poses.
    Localize(commands::localize::Args),
    /// Find by how much mounts and clocks of a vehicle's radars are off, from its drive logs.
    Calibrate(commands::calibrate::Args),
    /// Keep a copy of an area's map in a folder, as vehicles do.
    Tiles(commands::tiles::Args),
    /// Repeat the paper's experiments, and further ones, on simulated towns or on drive logs.
    #[cfg(feature = "lab")]
    Evaluate(echofix_lab::evaluate::command::Args),
    /// Make certificates for a service that others reach: authority, service, vehicles, operators.
    Identity(commands::identity::Args),
    /// Make a bearer token, by which a service knows a caller.
    Token(commands::token::Args),
    /// Look at the bucket that several services share: status, probe, sweep, verify.
    Cluster(commands::cluster::Args),
    /// Show whether a running service is ready, and what its map holds.
    Status(commands::status::Args),
    /// Print what a shell needs to complete this command.
    Completions(commands::shell::CompletionsArgs),
    /// Print the manual page, or write those of all subcommands.
    Man(commands::shell::ManArgs),
}

fn main() -> ExitCode {
    readers::may_leave();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return misread(&error),
    };
    let json = cli.json;
    match readers::read_to_the_end(|| run(cli)) {
        None => ExitCode::from(readers::GONE),
        Some(Ok(())) => ExitCode::SUCCESS,
        Some(Err(error)) => {
            if json {
                println!("{}", commands::error_json(&error));
            }
            eprintln!("error: {}", commands::error_words(&error));
            let missing =
                error.downcast_ref().is_some_and(echofix_server::config::Error::is_missing_identity);
            if missing { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

/// Tells what is wrong with the arguments, to machines, too, where that is asked for. Help and version are told as ever.
fn misread(error: &clap::Error) -> ExitCode {
    if error.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
        let told = error.to_string();
        let message = told.split("\n\n").next().unwrap_or_default().trim().trim_start_matches("error: ");
        println!("{}", commands::error_json(&anyhow::anyhow!("{message}")));
    }
    // Nobody may be there to read it.
    let _ = error.print();
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

fn run(cli: Cli) -> anyhow::Result<()> {
    let (json, credentials) = (cli.json, cli.credentials);
    match cli.command {
        Command::Serve(args) => commands::serve::run(&args),
        Command::Simulate(args) => blocking(move || commands::simulate::run(&args, json)),
        Command::Import(args) => blocking(move || commands::import::run(&args, json)),
        #[cfg(feature = "lab")]
        Command::Evaluate(args) => blocking(move || echofix_lab::evaluate::command::run(&args, json)),
        #[cfg(feature = "lab")]
        Command::Sizing(args) => blocking(move || echofix_lab::sizing::command::run(args, json)),
        Command::Calibrate(args) => blocking(move || commands::calibrate::run(&args, json)),
        Command::Identity(args) => commands::identity::run(&args, json),
        Command::Token(args) => commands::token::run(&args, json),
        Command::Completions(args) => commands::shell::completions(&args, Cli::command()),
        Command::Man(args) => commands::shell::man(&args, Cli::command()),
        Command::Status(args) => commands::status::run(&args, &credentials.resolved()?, json),
        Command::Demo(args) => in_runtime(interruptible(commands::demo::run(args, json))),
        Command::Cluster(args) => commands::cluster::run(&args, json),
        #[cfg(feature = "lab")]
        Command::Bench(args) => in_runtime(interruptible(echofix_lab::bench::command::run(args, json))),
        Command::Map(args) => in_runtime(commands::map::run(args, &credentials.resolved()?, json)),
        Command::Tiles(args) => {
            in_runtime(interruptible(commands::tiles::run(args, &credentials.resolved()?, json)))
        }
        Command::Localize(args) => {
            in_runtime(interruptible(commands::localize::run(args, &credentials, json)))
        }
    }
}

fn in_runtime(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let done = runtime.block_on(work);
    // A simulation or an alignment that nobody waits for any more.
    runtime.shutdown_background();
    done
}

/// Work that blocks, and ends when the user has had enough.
fn blocking(work: impl FnOnce() -> anyhow::Result<()> + Send + 'static) -> anyhow::Result<()> {
    in_runtime(interruptible(off_the_runtime(work)))
}

/// Work that blocks, on a thread where it may.
async fn off_the_runtime(work: impl FnOnce() -> anyhow::Result<()> + Send + 'static) -> anyhow::Result<()> {
    match tokio::task::spawn_blocking(work).await {
        Ok(done) => done,
        Err(broken) => match broken.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(broken) => Err(broken.into()),
        },
    }
}

/// Work that ends when the user has had enough, and says how far it came: what holds temporary folders and processes is dropped on the
/// way out, and what is half written is removed.
async fn interruptible(work: impl Future<Output = anyhow::Result<()>>) -> anyhow::Result<()> {
    tokio::select! {
        biased;
        done = work => done,
        interrupted = tokio::signal::ctrl_c() => {
            interrupted.context("waiting for an interrupt")?;
            unfinished::remove_all();
            let far = progress::how_far().map(|far| format!(" at {far}")).unwrap_or_default();
            anyhow::bail!("interrupted{far}")
        }
    }
}
