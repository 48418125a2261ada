//! `echofix cluster`: what is in the bucket that services share, asked without any of them.

use anyhow::ensure;
use echofix_server::store::SharedMap;
use serde_json::{Value, json};

/// Arguments of `echofix cluster`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    question: Question,
    /// The bucket, as `store.url` of the services has it: `s3://bucket/prefix`. Credentials come from AWS_* in the environment.
    #[arg(long, env = "ECHOFIX_STORE_URL", global = true, default_value = "")]
    url: String,
}

#[derive(clap::Subcommand)]
enum Question {
    /// Show what is in the bucket.
    Status,
    /// Let creations race, and see whether the store keeps its conditions. Services ask the same when they start.
    Probe,
    /// Delete what no longer counts and is older than an hour. Services do the same by themselves.
    Sweep,
    /// Read all that counts, and check it.
    Verify,
}

/// Runs the subcommand.
///
/// # Errors
/// When the store does not answer, holds no map, or `verify` finds damage.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    ensure!(!args.url.is_empty(), "name the bucket: --url s3://bucket/prefix, or ECHOFIX_STORE_URL");
    let map = SharedMap::at(&args.url)?;
    let mut sound = true;
    let answer = match args.question {
        Question::Status => serde_json::to_value(map.status()?)?,
        Question::Probe => {
            map.probe()?;
            json!({ "conditions": "kept" })
        }
        Question::Sweep => json!({ "deleted": map.sweep()? }),
        Question::Verify => {
            let found = map.verify()?;
            sound = found.damage.is_empty();
            let tiles = found.checkpoint_tiles;
            json!({ "sound": sound, "records": found.records, "compacted_tiles": tiles, "damage": found.damage })
        }
    };
    if json {
        println!("{answer}");
    } else {
        tell(&answer, "");
    }
    // Scripts read the exit code.
    ensure!(sound, "what is in the bucket is damaged");
    Ok(())
}

/// Each value in a line of its own, below a heading where it has parts.
fn tell(answer: &Value, indent: &str) {
    for (name, value) in answer.as_object().into_iter().flatten() {
        let name = name.replace('_', " ");
        match value {
            Value::Object(_) => {
                println!("{indent}{name}");
                tell(value, &format!("{indent}  "));
            }
            Value::Array(parts) if parts.is_empty() => println!("{indent}{name:<20} none"),
            Value::Array(parts) => {
                println!("{indent}{name}");
                for part in parts {
                    println!("{indent}  {}", plain(part));
                }
            }
            value => println!("{indent}{name:<20} {:>12}", plain(value)),
        }
    }
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".to_owned(),
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.to_owned(),
        other => other.to_string(),
    }
}
