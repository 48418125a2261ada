//! `echofix serve`: the service in this process, as `echofix-server` runs it.

use std::io::Write;
use std::time::Duration;

use echofix_server::args::ServeArgs;
use echofix_server::{log, run as service};
use tokio::sync::oneshot;

/// How long the process waits, at its end, for threads that still work.
const LAST_WORK: Duration = Duration::from_secs(1);

/// Arguments of `echofix serve`.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    service: ServeArgs,
    /// End when standard input ends: with the process that started this one, even if that one is killed.
    #[arg(long, hide = true)]
    end_with_stdin: bool,
}

/// Runs the subcommand until a signal ends it.
///
/// # Errors
/// When the configuration is wrong, a port is taken or the store does not open.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let signalled = {
        let _within = runtime.enter();
        service::signalled()?
    };
    let Args { service: args, end_with_stdin } = args;
    let config = args.config()?;
    if let Some(text) = args.instead_of_serving(&config)? {
        return Ok(std::io::stdout().write_all(text.as_bytes())?);
    }
    let exporting = {
        let _within = runtime.enter();
        log::init(&config.log, &config.trace)?
    };
    let ended = async {
        tokio::select! {
            () = signalled => {}
            () = stdin_closed(), if *end_with_stdin => {}
        }
    };
    let served = runtime.block_on(service::serve(
        config,
        env!("ECHOFIX_BUILT_FROM"),
        args.addr_file.as_deref(),
        ended,
    ));
    drop(exporting);
    runtime.shutdown_timeout(LAST_WORK);
    Ok(served?)
}

/// Resolves when standard input ends.
async fn stdin_closed() {
    let (sender, closed) = oneshot::channel();
    // Not a thread of the runtime: only the end of the input wakes it, and the runtime would wait for it.
    std::thread::spawn(move || {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink());
        sender.send(())
    });
    let _ = closed.await;
}
