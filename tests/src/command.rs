//! One run of the command, and what it said.

use std::ffi::OsStr;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::binary;

/// What a run of the command came to.
#[derive(Debug)]
pub struct CommandRun {
    /// The exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl CommandRun {
    /// The JSON of standard output; fails the test when the run failed or said something else.
    pub fn json(&self) -> Value {
        assert_eq!(self.code, Some(0), "{self:#?}");
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("not JSON ({error}): {self:#?}"))
    }

    /// The words of standard error; fails the test unless the run ended with exit code 1, silent on
    /// standard output.
    pub fn error(&self) -> &str {
        assert_eq!((self.code, self.stdout.as_str()), (Some(1), ""), "{self:#?}");
        &self.stderr
    }

    /// What the JSON of standard output says of the error; fails the test unless the run ended with exit
    /// code 1, and standard error says the same to people.
    pub fn json_error(&self) -> String {
        assert_eq!(self.code, Some(1), "{self:#?}");
        let said: Value = serde_json::from_str(&self.stdout)
            .unwrap_or_else(|error| panic!("not JSON ({error}): {self:#?}"));
        let message = said["error"]["message"].as_str().unwrap_or_else(|| panic!("no message: {self:#?}"));
        assert!(self.stderr.contains(message), "{self:#?}");
        message.to_owned()
    }
}

/// Runs `echofix` with arguments to its end.
pub fn echofix<A: AsRef<OsStr>>(arguments: impl IntoIterator<Item = A>) -> CommandRun {
    echofix_with(&[], arguments)
}

/// The same with variables.
pub fn echofix_with<A: AsRef<OsStr>>(
    variables: &[(&str, &str)],
    arguments: impl IntoIterator<Item = A>,
) -> CommandRun {
    let mut command = Command::new(binary::echofix());
    // What a developer has set must not decide a test.
    for name in ["SERVER", "HTTP", "CA", "CERT", "KEY", "TOKEN", "PROFILE"] {
        command.env_remove(format!("ECHOFIX_{name}"));
    }
    command.envs(variables.iter().copied());
    let output = command.args(arguments).stdin(Stdio::null()).output().expect("echofix can be run");
    let text = |bytes| String::from_utf8(bytes).expect("the command writes UTF-8");
    CommandRun { code: output.status.code(), stdout: text(output.stdout), stderr: text(output.stderr) }
}

/// The UTC date of tomorrow: before it is all that came until now.
pub fn tomorrow() -> String {
    let date = Command::new("date").args(["-u", "-d", "tomorrow", "+%F"]).output().expect("date can be run");
    String::from_utf8(date.stdout).expect("a date is text").trim().to_owned()
}
