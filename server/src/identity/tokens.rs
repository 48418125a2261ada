//! Bearer tokens. A file keeps their hashes, one a line, so that who reads the file learns no token.
//!
//! ```text
//! # role(s)   name     SHA-256 of the token
//! operator    alice    9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
//! ```
//!
//! A token is 256 random bits. Nothing is gained by hashing those slowly, and no two are close to each other: looking a hash up
//! tells nothing of the others by the time it takes.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use ring::digest::{SHA256, digest};

use super::caller::is_name;
use super::role::Roles;

/// How every token begins, so that one that got somewhere by mistake is found.
const PREFIX: &str = "echofix_";
/// Bytes of a token file, at most.
pub(super) const MAX_BYTES: u64 = 16 << 20;

/// The hash of a token.
pub(super) type TokenHash = [u8; 32];

/// Whose a token is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Holder {
    pub(super) name: String,
    pub(super) roles: Roles,
}

/// The tokens of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Tokens(HashMap<TokenHash, Holder>);

/// A line of a token file that says nothing.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct Malformed {
    line: usize,
    reason: String,
}

impl Tokens {
    /// Of a file's text.
    pub(super) fn read(text: &str) -> Result<Self, Malformed> {
        let mut tokens = HashMap::new();
        for (at, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let malformed = |reason: String| Malformed { line: at + 1, reason };
            let (hash, holder) = entry(line).map_err(malformed)?;
            if tokens.insert(hash, holder).is_some() {
                return Err(malformed("this token is listed above already".to_owned()));
            }
        }
        Ok(Self(tokens))
    }

    /// The holder of the token with this hash.
    pub(super) fn holder(&self, hash: &TokenHash) -> Option<&Holder> {
        self.0.get(hash)
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

fn entry(line: &str) -> Result<(TokenHash, Holder), String> {
    let mut parts = line.split_whitespace();
    let (Some(roles), Some(name), Some(hash), None) =
        (parts.next(), parts.next(), parts.next(), parts.next())
    else {
        return Err("expected role, name and hash; `echofix token create` writes such a line".to_owned());
    };
    let roles: Roles = roles.parse().map_err(|error| format!("{error}"))?;
    if !is_name(name) {
        return Err(format!("`{name}` is no name; use letters, digits and -._~@:+/, 64 at most"));
    }
    let hash = unhex(hash).ok_or("the hash is not 64 hexadecimal digits")?;
    Ok((hash, Holder { name: name.to_owned(), roles }))
}

/// The hash under which a token is known.
pub(super) fn hash_of(token: &str) -> TokenHash {
    let mut hash = [0; 32];
    hash.copy_from_slice(digest(&SHA256, token.as_bytes()).as_ref());
    hash
}

/// Draws a token and appends its hash to a file, which is made (0600) where there is none. The token itself is returned, and
/// kept nowhere.
///
/// # Errors
/// When the name or roles cannot be used, the system has no randomness, or the file cannot be written.
pub fn create(file: &Path, roles: Roles, name: &str) -> io::Result<String> {
    if !is_name(name) || roles.is_empty() {
        let why = format!("`{name}` is no name; use letters, digits and -._~@:+/, 64 at most");
        return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
    }
    let mut random = [0; 32];
    getrandom::fill(&mut random).map_err(io::Error::other)?;
    let token = format!("{PREFIX}{}", hex(&random));
    let mut out = OpenOptions::new().create(true).append(true).mode(0o600).open(file)?;
    out.write_all(format!("{roles} {name} {}\n", hex(&hash_of(&token))).as_bytes())?;
    out.sync_all()?;
    Ok(token)
}

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn unhex(text: &str) -> Option<TokenHash> {
    let digits = text.as_bytes();
    if digits.len() != 64 {
        return None;
    }
    let mut bytes = [0; 32];
    for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
        let digit = |c: u8| char::from(c).to_digit(16);
        *byte = u8::try_from(digit(pair[0])? << 4 | digit(pair[1])?).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identity::Role;

    #[test]
    fn a_created_token_is_found_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens");
        let token = create(&file, Role::Operator.into(), "alice").unwrap();
        let other = create(&file, "mapper,viewer".parse().unwrap(), "car-7").unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(!text.contains(&token) && !text.contains(&other), "a token is in the file");
        let mode = std::os::unix::fs::PermissionsExt::mode(&file.metadata().unwrap().permissions());
        assert_eq!(mode & 0o777, 0o600);
        let tokens = Tokens::read(&text).unwrap();
        assert_eq!((tokens.len(), token.len()), (2, PREFIX.len() + 64));
        assert_eq!(tokens.holder(&hash_of(&token)).unwrap().name, "alice");
        assert!(tokens.holder(&hash_of(&other)).unwrap().roles.include(Role::Vehicle));
        assert_eq!(tokens.holder(&hash_of(&token[1..])), None);
    }

    #[test]
    fn mistakes_name_their_line() {
        let hash = "0".repeat(64);
        for (text, words) in [
            (format!("# fine\n\nroot alice {hash}"), "line 3: `root` is no role"),
            (format!("operator a|b {hash}"), "line 1: `a|b` is no name"),
            ("operator alice 00".to_owned(), "line 1: the hash is not"),
            (format!("operator {hash}"), "line 1: expected role, name and hash"),
            (format!("operator a {hash}\nviewer b {hash}"), "line 2: this token is listed"),
        ] {
            assert!(Tokens::read(&text).unwrap_err().to_string().starts_with(words), "{text}");
        }
        assert!(create(Path::new("/nonexistent/file"), Role::Viewer.into(), "a b").is_err());
    }
}
