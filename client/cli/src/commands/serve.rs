//! `echofix serve`: the service in this process, as `echofix-server` runs it.

use std::time::Duration;

use echofix_server::args::ServeArgs;
use echofix_server::{log, run as service};

/// Work that still holds a thread at the end gets this long.
const LAST_WORK: Duration = Duration::from_secs(1);

/// Runs the subcommand until the process is told to end.
///
/// # Errors
/// When the configuration is wrong, a port is taken or the store does not open.
pub fn run(args: &ServeArgs) -> anyhow::Result<()> {
    let config = args.config()?;
    log::init(&config.log)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let served = runtime.block_on(service::serve(config, args.addr_file.as_deref(), service::signalled()));
    runtime.shutdown_timeout(LAST_WORK);
    Ok(served?)
}
