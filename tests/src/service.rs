//! The service as a process: started, killed, started again, ended, with its log.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

use echofix_harness::process::{Launch, ServiceProcess};
use tempfile::TempDir;

use crate::{binary, http, until_blocking};

/// From the start of the process until it is ready: what was acknowledged in a hurry is folded first.
const READY_WITHIN: Duration = Duration::from_mins(2);
/// From SIGTERM to the end of the process: the configured grace and some.
const ENDS_WITHIN: Duration = Duration::from_secs(12);

/// A service with a data directory of its own.
///
/// Dropping it kills the process and removes the directory; a test that fails prints the log. Kept in
/// a `static` it is never dropped: then a watchdog does the same once the test process is gone.
pub struct Service {
    folder: TempDir,
    setup: Setup,
    process: ServiceProcess,
    watchdog: Watchdog,
    /// `http://host:port` for vehicles.
    pub grpc: String,
    /// `http://host:port` for operators.
    pub http: String,
}

/// How a service is started.
#[derive(Debug, Clone, Default)]
pub struct Setup {
    /// Keys to set, each as `section.key=value`.
    pub settings: Vec<String>,
    /// The data directory, if it is not to be one of the service's own folder.
    pub data_dir: Option<PathBuf>,
    /// A deliberate defect, by its name in `ECHOFIX_FAULT`.
    pub fault: Option<&'static str>,
    /// Environment variables to set.
    pub variables: Vec<(&'static str, String)>,
    /// What to run in place of the `echofix` command.
    pub program: Option<PathBuf>,
}

impl Service {
    /// Starts a service with the default configuration on free ports and waits until it is ready.
    pub fn start() -> Self {
        Self::start_with(&[])
    }

    /// The same with some keys set, each as `section.key=value`.
    pub fn start_with(settings: &[&str]) -> Self {
        let settings = settings.iter().map(|&setting| setting.to_owned()).collect();
        Self::start_as(Setup { settings, ..Setup::default() })
    }

    /// Starts a service in some other way.
    pub fn start_as(setup: Setup) -> Self {
        let mut service = Self::launch_as(setup);
        service.wait_until_ready();
        service
    }

    /// The same without waiting until it is ready.
    pub fn launch_as(setup: Setup) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let process = launch(&folder, &setup);
        let watchdog = Watchdog::over(&process, &folder);
        Self { folder, setup, process, watchdog, grpc: String::new(), http: String::new() }
    }

    /// Ends the process as a crash would: kill -9.
    pub fn kill(&mut self) {
        self.watchdog.dismiss();
        self.process.kill().expect("the service can be killed");
    }

    /// Starts a killed or ended service again on the same data and waits until it is ready. It
    /// listens at other ports than before.
    pub fn start_again(&mut self) {
        self.launch_again();
        self.wait_until_ready();
    }

    /// The same without waiting.
    pub fn launch_again(&mut self) {
        assert!(self.has_ended(), "the service still runs");
        self.watchdog.dismiss();
        self.process = launch(&self.folder, &self.setup);
        self.watchdog = Watchdog::over(&self.process, &self.folder);
    }

    /// Asks the process to end (SIGTERM), without waiting.
    pub fn ask_to_end(&self) {
        self.signal("TERM");
    }

    /// Sends a signal by its name, as `TERM`.
    pub fn signal(&self, name: &str) {
        signal(self.process.pid(), name);
    }

    /// Waits until the process listens for SIGTERM; before, it would just be killed.
    pub fn wait_until_it_hears(&self) {
        const TERM: u32 = 15;
        until_blocking("the service hears signals", READY_WITHIN, || {
            let status = fs::read_to_string(format!("/proc/{}/status", self.pid())).ok()?;
            let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"))?;
            let caught = u64::from_str_radix(caught.trim(), 16).ok()?;
            (caught >> (TERM - 1) & 1 == 1).then_some(())
        });
    }

    /// Other keys from the next start on.
    pub fn set(&mut self, settings: &[&str]) {
        self.setup.settings.extend(settings.iter().map(|&setting| setting.to_owned()));
    }

    /// Stops the process (SIGSTOP), as a machine that hangs would be, or lets it go on.
    pub fn stall(&self, stalled: bool) {
        self.signal(if stalled { "STOP" } else { "CONT" });
    }

    /// Waits for the end of a process that was asked to end.
    pub fn ended(&mut self) -> ExitStatus {
        until_blocking("the service has ended", ENDS_WITHIN, || {
            self.process.ended().expect("the service is ours to wait for")
        })
    }

    /// Whether the process has ended.
    pub fn has_ended(&mut self) -> bool {
        self.process.ended().expect("the service is ours to wait for").is_some()
    }

    /// The number of the process.
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// The process.
    pub fn process(&self) -> &ServiceProcess {
        &self.process
    }

    /// The data directory.
    pub fn data_dir(&self) -> PathBuf {
        data_dir(&self.folder, &self.setup)
    }

    /// A folder that goes with the service, for whatever a test has to write.
    pub fn scratch(&self) -> PathBuf {
        let scratch = self.folder.path().join("scratch");
        fs::create_dir_all(&scratch).expect("a folder can be made");
        scratch
    }

    /// What it has logged so far, over all its starts.
    pub fn log(&self) -> String {
        self.process.log()
    }

    /// Waits until a launched service is ready or has ended; says which.
    pub fn becomes_ready(&mut self) -> bool {
        until_blocking("the service is ready or ended", READY_WITHIN, || {
            if self.has_ended() {
                return Some(false);
            }
            let ready = self.process.listens() && ready(&self.process.http);
            ready.then_some(true)
        }) && {
            self.wait_until_ready();
            true
        }
    }

    /// Waits until a launched service is ready.
    pub fn wait_until_ready(&mut self) {
        until_blocking("the service listens", READY_WITHIN, || {
            assert!(!self.has_ended(), "the service did not start:\n{}", self.log());
            self.process.listens().then_some(())
        });
        (self.grpc, self.http) = (self.process.grpc.clone(), self.process.http.clone());
        until_blocking("the service is ready", READY_WITHIN, || {
            assert!(!self.has_ended(), "the service ended while it started:\n{}", self.log());
            ready(&self.http).then_some(())
        });
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.watchdog.dismiss();
        // It may have ended already; its log is whole once it has.
        let _ = self.process.kill();
        if std::thread::panicking() {
            eprintln!("--- the service's log ---\n{}--- end of the log ---", self.log());
        }
    }
}

fn data_dir(folder: &TempDir, setup: &Setup) -> PathBuf {
    setup.data_dir.clone().unwrap_or_else(|| folder.path().join("data"))
}

fn launch(folder: &TempDir, setup: &Setup) -> ServiceProcess {
    // One vehicle is enough to make a map, unless a test says otherwise.
    let mut settings = vec!["mapping.publish_contributors=1".to_owned()];
    settings.extend(setup.settings.iter().cloned());
    let launch = Launch {
        program: setup.program.as_deref().unwrap_or(binary::echofix()),
        folder: folder.path(),
        data_dir: &data_dir(folder, setup),
        settings,
        variables: setup
            .variables
            .iter()
            .map(|(name, value)| (*name, &value[..]))
            .chain(setup.fault.map(|fault| ("ECHOFIX_FAULT", fault)))
            .collect(),
    };
    ServiceProcess::launch(&launch).expect("echofix can be run")
}

fn ready(http: &str) -> bool {
    http::try_get(&format!("{http}/readyz")).is_some_and(|answer| answer.status == 200)
}

/// Sends a signal to a process that is ours and not yet waited for.
fn signal(process: u32, name: &str) {
    let mut kill = Command::new("sh");
    let sent = kill.args(["-c", "kill -s \"$0\" \"$1\"", name, &process.to_string()]).status();
    assert!(sent.expect("sh can be run").success(), "SIG{name} could not be sent");
}

/// Ends the service and removes its folder when the test process is gone, however it went: then the
/// pipe it reads from closes.
struct Watchdog(Child);

impl Watchdog {
    fn over(process: &ServiceProcess, folder: &TempDir) -> Self {
        let mut dog = Command::new("sh");
        dog.args(["-c", "read -r _; kill -s KILL \"$0\"; rm -rf \"$1\""]).arg(process.pid().to_string());
        dog.arg(folder.path()).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        Self(dog.spawn().expect("sh can be run"))
    }

    /// Before the process is waited for, or its number could be another's by the time it is killed.
    fn dismiss(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.dismiss();
    }
}
