//! What the system refuses a running service: room in files, open files. With `prlimit`, so that no file system has to be
//! filled and no rights are needed.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

use crate::binary;
use crate::service::Service;

/// The `echofix` command under a shell that has told the system to send it no signal when a file may not grow: it is to see
/// the error instead, as on a full disk.
pub struct Unsignalled {
    folder: TempDir,
}

impl Unsignalled {
    /// Makes it.
    pub fn new() -> Self {
        let unsignalled = Self { folder: tempfile::tempdir().expect("a folder can be made") };
        let program = binary::echofix().display().to_string();
        let script = format!("#!/bin/sh\ntrap '' XFSZ\nexec '{program}' \"$@\"\n");
        fs::write(unsignalled.program(), script).expect("a script can be written");
        let executable = fs::Permissions::from_mode(0o755);
        fs::set_permissions(unsignalled.program(), executable).expect("a script can be made executable");
        unsignalled
    }

    /// What to run in place of the command.
    pub fn program(&self) -> PathBuf {
        self.folder.path().join("echofix")
    }
}

impl Default for Unsignalled {
    fn default() -> Self {
        Self::new()
    }
}

/// No file of the service may be written to beyond so many bytes; `None` for no limit.
pub fn file_bytes(service: &Service, bytes: Option<u64>) {
    set(service, "fsize", bytes);
}

/// The service may open no file beyond those that are open; `None` lets it open a thousand.
pub fn no_more_files(service: &Service, now: bool) {
    let open =
        fs::read_dir(format!("/proc/{}/fd", service.pid())).expect("the process is ours").count() as u64;
    set(service, "nofile", Some(if now { open } else { 1000 }));
}

fn set(service: &Service, resource: &str, value: Option<u64>) {
    // The soft limit only: the hard one could not be raised again.
    let limit = value.map_or_else(|| "unlimited".to_owned(), |value| value.to_string());
    let mut prlimit = Command::new("prlimit");
    prlimit.arg("--pid").arg(service.pid().to_string()).arg(format!("--{resource}={limit}:"));
    let status = prlimit.status().expect("prlimit, of util-linux, can be run");
    assert!(status.success(), "{prlimit:?}");
}
