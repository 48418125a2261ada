//! Profiles: a service's addresses, and who the command is to it, under a name in a file of the user's.
//!
//! ```toml
//! [maps]
//! server = "https://maps.example:50051"
//! http = "https://maps.example:8080"
//! ca = "maps-ca.pem"            # paths count from the file's own folder
//! token_file = "maps-token"
//! ```

use std::collections::BTreeMap;
use std::env;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use serde::Deserialize;

/// Bytes of the file, at most.
const MAX_BYTES: u64 = 1 << 20;
/// The rights of others on a file: its group and everybody may neither read nor change what holds a token.
const OF_OTHERS: u32 = 0o066;

/// What a profile tells. Paths are those of the file, made whole.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// URL of the vehicles' port.
    pub server: Option<String>,
    /// URL of the operators' port.
    pub http: Option<String>,
    /// PEM file of the authority that signed the service's certificate.
    pub ca: Option<PathBuf>,
    /// PEM file of the caller's certificate.
    pub cert: Option<PathBuf>,
    /// PEM file of that certificate's key.
    pub key: Option<PathBuf>,
    /// The caller's token.
    pub token: Option<String>,
    /// The file with the caller's token.
    pub token_file: Option<PathBuf>,
}

/// Where profiles are: `echofix/profiles.toml` below `XDG_CONFIG_HOME`, or below `~/.config`.
///
/// # Errors
/// When neither that nor `HOME` says where.
pub fn file() -> anyhow::Result<PathBuf> {
    // A relative path is invalid there, as if it were not set (XDG Base Directory Specification).
    let set = |name: &str| env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let config = set("XDG_CONFIG_HOME").or_else(|| Some(set("HOME")?.join(".config")));
    let config = config.context("a profile needs a folder: set HOME or XDG_CONFIG_HOME to a whole path")?;
    Ok(config.join("echofix/profiles.toml"))
}

impl Profile {
    /// The profile of a name, with the token of its `token_file` read.
    ///
    /// # Errors
    /// When the file cannot be read, says something that no profile has, has no such profile, or when others may read a token.
    pub fn named(name: &str, file: &Path) -> anyhow::Result<Self> {
        let shown = file.display();
        let reading = || format!("reading the profile `{name}`");
        let (text, others) = read(file).with_context(reading)?;
        let mut profiles: BTreeMap<String, Self> = toml::from_str(&text).map_err(|error| {
            // The error's own text shows the line, which may hold a token.
            let line = error.span().map_or(0, |span| text[..span.start].matches('\n').count()) + 1;
            anyhow::anyhow!("{shown}, line {line}: {}", error.message().trim())
        })?;
        let secret = profiles.values().any(|profile| profile.token.is_some());
        let named = profiles.remove(name).with_context(|| {
            let known: Vec<_> = profiles.keys().map(String::as_str).collect();
            format!("{shown} has no profile `{name}`; it has {}", known.join(", "))
        })?;
        ensure!(!(others && (secret || named.token_file.is_some())), may_read(file));
        let folder = file.parent().unwrap_or(Path::new(""));
        named.whole(folder).with_context(|| format!("the profile `{name}` of {shown}"))
    }

    /// With paths from a folder, and its token read.
    fn whole(self, folder: &Path) -> anyhow::Result<Self> {
        let at = |path: Option<PathBuf>| path.map(|path| folder.join(path));
        let token = match (self.token, at(self.token_file)) {
            (Some(_), Some(_)) => bail!("`token` and `token_file` are one too many"),
            (None, Some(file)) => Some(token_of(&file)?),
            (token, None) => token,
        };
        let (ca, cert, key) = (at(self.ca), at(self.cert), at(self.key));
        ensure!(cert.is_some() == key.is_some(), "`cert` and `key` go together");
        Ok(Self { ca, cert, key, token, token_file: None, ..self })
    }
}

fn token_of(file: &Path) -> anyhow::Result<String> {
    let (text, others) = read(file).context("reading `token_file`")?;
    ensure!(!others, may_read(file));
    let token = text.trim();
    ensure!(!token.is_empty() && !token.contains(char::is_whitespace), "{} holds no token", file.display());
    Ok(token.to_owned())
}

/// The text of a file, and whether others may read or change it.
fn read(path: &Path) -> anyhow::Result<(String, bool)> {
    let reading = || path.display().to_string();
    let file = File::open(path).with_context(reading)?;
    let mode = file.metadata().with_context(reading)?.permissions().mode();
    let mut text = String::new();
    file.take(MAX_BYTES).read_to_string(&mut text).with_context(reading)?;
    Ok((text, mode & OF_OTHERS != 0))
}

fn may_read(file: &Path) -> String {
    let file = file.display();
    format!(
        "others may read or change {file}, which is to hold a token: `chmod 600 {file}`, and get another token"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn named(name: &str, text: &str, mode: u32) -> Result<Profile, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("profiles.toml");
        fs::write(folder.path().join("secret"), "echofix_2\n").unwrap();
        for (file, text) in [("profiles.toml", text), ("secret", "echofix_2\n")] {
            let file = folder.path().join(file);
            fs::write(&file, text).unwrap();
            fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
        }
        let named = Profile::named(name, &file).map_err(|error| format!("{error:#}"))?;
        let bare =
            |path: Option<PathBuf>| path.map(|p| p.strip_prefix(folder.path()).unwrap_or(&p).to_owned());
        Ok(Profile { ca: bare(named.ca), cert: bare(named.cert), key: bare(named.key), ..named })
    }

    /// Catches: a profile of another name, paths that count from wherever the command runs, and a token file that is not read.
    #[test]
    fn a_profile_is_read_whole_by_its_name() {
        let text =
            "[a]\nserver = 'https://a:1'\nca = 'ca.pem'\ntoken_file = 'secret'\n[b]\ncert = '/c'\nkey = 'k'";
        let a = named("a", text, 0o600).unwrap();
        assert_eq!((a.server.as_deref(), a.token.as_deref()), (Some("https://a:1"), Some("echofix_2")));
        assert_eq!((a.ca, a.http), (Some("ca.pem".into()), None));
        let b = named("b", text, 0o644).unwrap();
        assert_eq!((b.cert, b.key, b.token), (Some("/c".into()), Some("k".into()), None));
    }

    /// Catches: a token that everybody on the machine reads, and one that an error message shows.
    #[test]
    fn tokens_are_the_users_alone() {
        for text in
            ["[a]\ntoken = 'echofix_1'", "[a]\n[b]\ntoken = 'echofix_1'", "[a]\ntoken_file = 'secret'"]
        {
            assert!(named("a", text, 0o600).is_ok() && named("a", text, 0o400).is_ok(), "{text}");
            for mode in [0o640, 0o604, 0o620, 0o644, 0o660] {
                let refused = named("a", text, mode).unwrap_err();
                assert!(refused.contains("chmod 600"), "{mode:o}: {refused}");
            }
        }
        let broken = named("a", "[a]\n\ntoken = 'echofix_1' 'x'", 0o600).unwrap_err();
        assert!(broken.contains("line 3") && !broken.contains("echofix_1"), "{broken}");
    }

    #[test]
    fn what_no_profile_has_is_named() {
        for (text, words) in [
            ("[a]\ntokn = 'x'", "line 2: unknown field `tokn`"),
            ("[a]\naddress = 3", "unknown field `address`"),
            ("[a]\nserver = 3", "invalid type"),
            ("server = 'https://a:1'", "line 1"),
            ("[b]\n[c]", "no profile `a`; it has b, c"),
            ("[a]\ntoken = 'x'\ntoken_file = 'secret'", "one too many"),
            ("[a]\ncert = 'x'", "`cert` and `key` go together"),
            ("[a]\ntoken_file = 'none'", "none"),
        ] {
            let refused = named("a", text, 0o600).unwrap_err();
            assert!(refused.contains(words), "{text}: {refused}");
        }
    }
}
