//! Services and callers under names in a file of the user's.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;

use echofix_tests::command::{CommandRun, echofix_with};

use super::site::Site;

const HISTORY: [&str; 3] = ["--json", "map", "history"];

struct Home {
    folder: tempfile::TempDir,
}

impl Home {
    fn with(profiles: &str, mode: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join(".config/echofix")).unwrap();
        let home = Self { folder };
        home.write("profiles.toml", profiles, mode);
        home
    }

    fn write(&self, name: &str, text: &str, mode: u32) {
        let file = self.folder.path().join(".config/echofix").join(name);
        fs::write(&file, text).unwrap();
        fs::set_permissions(file, Permissions::from_mode(mode)).unwrap();
    }

    /// Runs the command as its user.
    fn run(&self, arguments: &[&str], variables: &[(&str, &str)]) -> CommandRun {
        let home = self.folder.path().to_str().unwrap();
        let own = [("HOME", home), ("XDG_CONFIG_HOME", "")];
        echofix_with(&[&own, variables].concat(), arguments)
    }
}

/// Who a run was to the service, by what it was refused for.
fn refused(run: &CommandRun) -> &str {
    assert_eq!(run.code, Some(1), "{run:?}");
    &run.stderr
}

/// Catches: a profile that names another service or caller than it says, one that counts before what was said for this run, and
/// a command that takes no profile.
#[test]
fn a_profile_says_where_and_who_unless_something_else_does() {
    let site = Site::start();
    let (ca, viewer, vehicle) = (site.ca().display(), site.token("viewer"), site.token("vehicle"));
    let (cert, key) = site.certificate_files("mapper");
    let [cert, key] = [cert, key].map(|path| path.display().to_string());
    let (server, http) = (&site.grpc, &site.http);
    let service = format!("server = '{server}'\nhttp = '{http}'\nca = '{ca}'\n");
    let home = Home::with(
        &format!(
            "[viewer]\n{service}token = '{viewer}'\n[vehicle]\n{service}token_file = 'car'\n\
             [mapper]\n{service}cert = '{cert}'\nkey = '{key}'\n[elsewhere]\nhttp = 'http://127.0.0.1:1'\n"
        ),
        0o600,
    );
    home.write("car", &format!("{vehicle}\n"), 0o600);

    let by_flag = home.run(&[&HISTORY[..], &["--profile", "viewer"]].concat(), &[]);
    assert!(by_flag.json()["events"].is_array());
    let by_variable = home.run(&HISTORY, &[("ECHOFIX_PROFILE", "viewer")]);
    assert!(by_variable.json()["events"].is_array());
    let status = home.run(&["--profile", "viewer", "--json", "status"], &[]).json();
    assert_eq!(status["readiness"]["ready"], true);
    // A flag counts before a variable, and both before what the profile says.
    let vehicle_named = [&HISTORY[..], &["--profile", "vehicle"]].concat();
    let by_both = home.run(&vehicle_named, &[("ECHOFIX_PROFILE", "viewer")]);
    assert!(refused(&by_both).contains("vehicle-1 has vehicle"), "{by_both:?}");
    assert_eq!(home.run(&vehicle_named, &[("ECHOFIX_TOKEN", &viewer)]).code, Some(0));
    let token = [&vehicle_named[..], &["--token", "echofix_wrong"]].concat();
    assert!(refused(&home.run(&token, &[("ECHOFIX_TOKEN", &viewer)])).contains("not known"));
    let shown = [&HISTORY[..], &["--profile", "viewer", "--cert", &cert, "--key", &key]].concat();
    assert!(refused(&home.run(&shown, &[])).contains("mapper-1 has mapper"), "not the profile's token");
    let elsewhere =
        home.run(&HISTORY, &[("ECHOFIX_PROFILE", "viewer"), ("ECHOFIX_HTTP", "http://127.0.0.1:1")]);
    assert!(refused(&elsewhere).contains("127.0.0.1:1"), "{elsewhere:?}");

    let tiles = home.folder.path().join("tiles").display().to_string();
    for profile in ["vehicle", "mapper"] {
        let synced = home.run(&["tiles", "sync", &tiles, "--profile", profile], &[]);
        assert_eq!(synced.code, Some(0), "{synced:?}");
    }
    let viewers = home.run(&["tiles", "sync", &tiles, "--profile", "viewer"], &[]);
    assert!(refused(&viewers).contains("viewer-1"), "{viewers:?}");
}

/// Catches: a token that others on the machine can read and that is used all the same, a key that is misspelt and means nothing,
/// and an error that shows a token.
#[test]
fn a_profile_that_is_no_good_is_refused_before_anything_is_sent() {
    let run = |text: &str, mode: u32| {
        let home = Home::with(text, mode);
        home.write("car", "echofix_7", 0o644);
        let run = home.run(&["status", "--profile", "a"], &[]);
        assert!(!run.stderr.contains("echofix_7"), "{run:?}");
        refused(&run).to_owned()
    };
    assert!(run("[a]\ntoken = 'echofix_7'", 0o644).contains("chmod 600"));
    assert!(run("[a]\ntoken_file = 'car'", 0o600).contains("chmod 600"));
    assert!(run("[a]\ntokn = 'echofix_7'", 0o600).contains("unknown field `tokn`"));
    assert!(run("[a]\ntoken = ['echofix_7'", 0o600).contains("line 2"));
    assert!(run("[b]\ntoken = 'echofix_7'", 0o600).contains("no profile `a`"));
    let home = Home::with("", 0o600);
    let none = home.run(&["status", "--profile", "a"], &[("XDG_CONFIG_HOME", "/nonexistent")]);
    assert!(refused(&none).contains("/nonexistent/echofix/profiles.toml"), "{none:?}");
    // What asks no service needs none.
    let check = ["serve", "--check-config", "--grpc-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0"];
    assert_eq!(home.run(&check, &[("ECHOFIX_PROFILE", "a")]).code, Some(0));
}
