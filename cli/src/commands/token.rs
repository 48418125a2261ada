//! `echofix token create`: a bearer token, by which a service knows a caller.

use std::path::PathBuf;

use anyhow::Context;
use echofix_server::identity::Roles;
use echofix_server::identity::tokens::create;

/// Arguments of `echofix token`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    operation: TokenOperation,
}

#[derive(clap::Subcommand)]
enum TokenOperation {
    /// Print a new token, once, and append its hash to the file that `identity.tokens` names. To take a token back, remove its
    /// line.
    Create {
        /// What its holder may do: vehicle, mapper, gateway, viewer, operator, admin or replica; several with commas between.
        #[arg(long)]
        role: Roles,
        /// The holder's name. Uploads count under it; a gateway may also upload for names below it, as acme/car-7 for acme.
        #[arg(long)]
        name: String,
        /// The file with the hashes.
        #[arg(long, default_value = "echofix-tokens")]
        file: PathBuf,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// When the name cannot be used or the file not be written.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let TokenOperation::Create { role, name, file } = &args.operation;
    let token = create(file, *role, name).with_context(|| format!("adding a token to {}", file.display()))?;
    if json {
        println!("{}", serde_json::json!({ "token": token, "name": name, "role": role.to_string() }));
    } else {
        println!("{token}");
        eprintln!(
            "This is shown once. The service takes it with `identity.tokens = \"{}\"`; callers give it as --token or in \
             ECHOFIX_TOKEN.",
            file.display()
        );
    }
    Ok(())
}
