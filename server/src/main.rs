//! The Echofix service as a program: parse, build, run.

use std::error::Error;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use echofix_server::args::ServeArgs;
use echofix_server::{log, run};

/// Work that still holds a thread at the end gets this long.
const LAST_WORK: Duration = Duration::from_secs(1);

/// All-weather positioning from automotive radar: gRPC for vehicles, HTTP for operators.
#[derive(Parser)]
#[command(name = "echofix-server", version)]
struct Args {
    #[command(flatten)]
    serve: ServeArgs,
    /// Check the configuration and end
    #[arg(long)]
    check_config: bool,
    /// Print the configuration in force and end
    #[arg(long, conflicts_with = "check_config")]
    print_config: bool,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Nobody is left to tell when standard error is gone.
            let _ = writeln!(std::io::stderr(), "echofix-server: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &Args) -> Result<(), Box<dyn Error>> {
    let config = args.serve.config()?;
    if args.check_config {
        return Ok(());
    }
    if args.print_config {
        return Ok(std::io::stdout().write_all(config.to_toml().as_bytes())?);
    }
    log::init(&config.log)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let served = runtime.block_on(run::serve(config, args.serve.addr_file.as_deref(), run::signalled()));
    runtime.shutdown_timeout(LAST_WORK);
    Ok(served?)
}
