//! The Echofix service as a program: parse, build, run.

use std::error::Error;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use echofix_server::args::ServeArgs;
use echofix_server::{config, log, run};

/// Set by whoever builds it.
const COMMIT: &str = match option_env!("ECHOFIX_COMMIT") {
    Some(commit) => commit,
    None => "unknown",
};
/// Work that still holds a thread at the end gets this long.
const LAST_WORK: Duration = Duration::from_secs(1);

/// All-weather positioning from automotive radar: gRPC for vehicles, HTTP for operators.
#[derive(Parser)]
#[command(name = "echofix-server", version)]
struct Args {
    #[command(flatten)]
    serve: ServeArgs,
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Without standard error there is nowhere to report it.
            let _ = writeln!(std::io::stderr(), "echofix-server: {error}");
            let missing = error.downcast_ref().is_some_and(config::Error::is_missing_identity);
            if missing { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = {
        let _within = runtime.enter();
        run::signalled()?
    };
    let args = Args::parse();
    let config = args.serve.config()?;
    if let Some(text) = args.serve.instead_of_serving(&config)? {
        return Ok(std::io::stdout().write_all(text.as_bytes())?);
    }
    let exporting = {
        let _within = runtime.enter();
        log::init(&config.log, &config.trace)?
    };
    let served = runtime.block_on(run::serve(config, COMMIT, args.serve.addr_file.as_deref(), ended));
    drop(exporting);
    runtime.shutdown_timeout(LAST_WORK);
    Ok(served?)
}
