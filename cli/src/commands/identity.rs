//! `echofix identity`: an authority of one's own, and certificates of it.

mod authority;

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use echofix_server::identity::Role;

use authority::Authority;

/// Arguments of `echofix identity`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    operation: IdentityOperation,
}

#[derive(clap::Subcommand)]
enum IdentityOperation {
    /// Make an authority, the service's certificate, that of a mapping vehicle (car-1) and that of an operator, and print what to
    /// configure.
    Init {
        /// The folder, which must not exist yet or be empty.
        dir: PathBuf,
        /// A name or an address by which callers reach the service; may be repeated.
        #[arg(long = "name", default_values = ["localhost", "127.0.0.1"])]
        names: Vec<String>,
    },
    /// Issue one more certificate.
    Issue {
        /// The folder that `init` made.
        dir: PathBuf,
        /// What its holder may do: vehicle, mapper, gateway, viewer, operator, admin or replica.
        #[arg(long)]
        role: Role,
        /// The holder's name. Uploads count under it; a gateway may also upload for names below it, as acme/car-7 for acme.
        #[arg(long)]
        name: String,
    },
    /// Take certificates back: write the list of revoked certificates, crl.pem, with one more.
    Revoke {
        /// The folder that `init` made.
        dir: PathBuf,
        /// The certificate.
        certificate: PathBuf,
    },
}

/// Runs the subcommand.
///
/// # Errors
/// When the folder cannot be written, or holds something already.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    match &args.operation {
        IdentityOperation::Init { dir, names } => init(dir, names, json),
        IdentityOperation::Issue { dir, role, name } => {
            let file = Authority::open(dir)?.issue(*role, name)?;
            told(json, &serde_json::json!({ "certificate": file }), &format!("{}", file.display()));
            Ok(())
        }
        IdentityOperation::Revoke { dir, certificate } => {
            let count = Authority::open(dir)?.revoke(certificate)?;
            let text = format!("{} lists {count} revoked certificates", dir.join("crl.pem").display());
            told(json, &serde_json::json!({ "revoked": count }), &text);
            Ok(())
        }
    }
}

fn told(json: bool, machine: &serde_json::Value, people: &str) {
    if json { println!("{machine}") } else { println!("{people}") }
}

fn init(dir: &Path, names: &[String], json: bool) -> anyhow::Result<()> {
    let empty = std::fs::read_dir(dir).map_or(true, |mut entries| entries.next().is_none());
    ensure!(empty, "{} holds something already; name another folder", dir.display());
    let authority = Authority::found(dir)?;
    authority.service(names)?;
    let vehicle = authority.issue(Role::Mapper, "car-1")?;
    let operator = authority.issue(Role::Operator, "operator-1")?;
    let dir = dir.canonicalize().context("looking for the folder that was made")?;
    let host = names.first().map_or("localhost", String::as_str);
    let configuration = format!(
        "[tls]\ncertificate = \"{0}/server.pem\"\nkey = \"{0}/server.key\"\nclient_ca = \"{0}/ca.pem\"\ncrl = \"{0}/crl.pem\"",
        dir.display()
    );
    let call = |file: &Path| {
        let (file, key) = (file.display(), file.with_extension("key"));
        format!("--ca {}/ca.pem --cert {file} --key {}", dir.display(), key.display())
    };
    let (vehicle, operator) = (call(&vehicle), call(&operator));
    let machine =
        serde_json::json!({ "configuration": configuration, "vehicle": vehicle, "operator": operator });
    let people = format!(
        "Configure the service (echofix serve --config FILE):\n\n{configuration}\n\nA vehicle then calls it like this:\n\n  \
         echofix map DRIVE.mcap --server https://{host}:50051 {vehicle}\n\nand an operator like this:\n\n  \
         echofix status --http https://{host}:8080 {operator}\n\nKeep ca.key off the service's machine: whoever has it makes \
         certificates."
    );
    told(json, &machine, &people);
    Ok(())
}
