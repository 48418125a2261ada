//! `echofix completions` and `echofix man`: what a shell and `man` know of the command.

use std::path::PathBuf;

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;

/// Arguments of `echofix completions`.
#[derive(clap::Args)]
pub struct CompletionsArgs {
    /// The shell.
    shell: Shell,
}

/// Arguments of `echofix man`.
#[derive(clap::Args)]
pub struct ManArgs {
    /// Write the pages of all subcommands into this folder. Without it, the command's own page goes to standard output.
    dir: Option<PathBuf>,
}

/// Prints the completions.
///
/// # Errors
/// When nobody reads them.
pub fn completions(args: &CompletionsArgs, mut command: Command) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "echofix", &mut script);
    Ok(std::io::Write::write_all(&mut std::io::stdout(), &script)?)
}

/// Writes the pages.
///
/// # Errors
/// When they cannot be written.
pub fn man(args: &ManArgs, command: Command) -> anyhow::Result<()> {
    let Some(dir) = &args.dir else {
        return Ok(clap_mangen::Man::new(command).render(&mut std::io::stdout())?);
    };
    let writing = || format!("writing manual pages to {}", dir.display());
    std::fs::create_dir_all(dir).with_context(writing)?;
    clap_mangen::generate_to(command, dir).with_context(writing)
}
