//! The key that contributors' pseudonyms are hashed with. Under another one every contributor would be a new one, so it
//! is checksummed, and a copy of it is kept beside it.
//!
//! ```text
//! magic "EFK" 1 (4) | CRC-32C of the rest (4) | key (16)
//! ```
//!
//! Before it had this form it was its 16 bytes alone; such a file is taken as it is, once.

use std::fs;
use std::hash::Hasher;
use std::io::{self, Write};
use std::path::Path;

use siphasher::sip::SipHasher24;

use super::files::at;
use super::files::put_file;
use crate::store::api::{Error, io_error};
use crate::store::checksum::{seal, sealed};

const MAGIC: [u8; 4] = *b"EFK\x01";
const NAME: &str = "key";
const COPY: &str = "key-copy";
const LENGTH: usize = 24;

pub(super) struct ContributorKey([u8; 16]);

/// What a file of the key holds.
#[derive(PartialEq, Eq)]
enum Found {
    Missing,
    Sound([u8; 16]),
    /// Of before there was a checksum.
    Bare([u8; 16]),
    Damaged,
}

impl ContributorKey {
    /// The key of a directory. It is made where there is none and `needed` does not say that records name
    /// contributors by it.
    pub(super) fn open(root: &Path, needed: bool) -> Result<Self, Error> {
        let (key, copy) = (found(root, NAME)?, found(root, COPY)?);
        match (key, copy) {
            (Found::Sound(key), Found::Sound(copy)) if key == copy => Ok(Self(key)),
            (Found::Sound(_), Found::Sound(_)) => Err(two_keys(root)),
            (Found::Sound(key) | Found::Bare(key), Found::Missing) => Self(key).kept(root),
            (Found::Sound(key), _) | (_, Found::Sound(key)) => {
                tracing::warn!(dir = %root.display(), "the key or its copy was damaged or missing; the sound one is taken");
                Self(key).kept(root)
            }
            (Found::Missing, Found::Missing) if !needed => {
                let mut key = [0; 16];
                getrandom::fill(&mut key)
                    .map_err(|error| io_error("drawing a key")(io::Error::other(error)))?;
                Self(key).kept(root)
            }
            _ => Err(lost(root)),
        }
    }

    /// SipHash-2-4 of a contributor's pseudonym.
    pub(super) fn hash(&self, pseudonym: &str) -> u64 {
        let mut hasher = SipHasher24::new_with_key(&self.0);
        hasher.write(pseudonym.as_bytes());
        hasher.finish()
    }

    /// What is wrong on disk, in sentences.
    pub(super) fn damage(&self, root: &Path) -> Vec<String> {
        let wrong = |name: &&&str| !matches!(found(root, name), Ok(Found::Sound(key)) if key == self.0);
        let sentence = |name: &str| {
            format!("{} is missing or damaged; a restart mends it from its copy", root.join(name).display())
        };
        [NAME, COPY].iter().filter(wrong).map(|name| sentence(name)).collect()
    }

    /// Brings the key and its copy to disk where they are not sound. A file that is not is kept under another name.
    fn kept(self, root: &Path) -> Result<Self, Error> {
        let mut bytes = [0; LENGTH];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[8..].copy_from_slice(&self.0);
        seal(&mut bytes[4..], &[]);
        for name in [NAME, COPY] {
            let (path, writing) = (root.join(name), "writing the key or its copy");
            match found(root, name)? {
                Found::Sound(_) => continue,
                Found::Damaged => {
                    let aside = root.join(format!("{name}.damaged"));
                    fs::rename(&path, aside).map_err(at(&path, writing))?;
                }
                Found::Missing | Found::Bare(_) => {}
            }
            put_file(root, name, |file| file.write_all(&bytes)).map_err(at(&path, writing))?;
        }
        Ok(self)
    }
}

fn found(root: &Path, name: &str) -> Result<Found, Error> {
    let path = root.join(name);
    let bytes = match fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Found::Missing),
        Err(error) => return Err(at(&path, "reading the key")(error)),
    };
    let framed = || {
        let bytes: &[u8; LENGTH] = bytes.as_slice().try_into().ok()?;
        let key = sealed(&bytes[4..], &[])?.try_into().ok()?;
        (bytes[..4] == MAGIC).then_some(Found::Sound(key))
    };
    let bare = || bytes.as_slice().try_into().ok().map(Found::Bare);
    Ok(framed().or_else(bare).unwrap_or(Found::Damaged))
}

/// Under a new key every contributor would count again, as another one.
fn lost(root: &Path) -> Error {
    Error::Damaged {
        what: format!("the data directory {}", root.display()),
        reason: "the file `key` and its copy `key-copy` are missing or damaged, and its journal holds uploads. Restore it \
                 from a backup, or put 16 random bytes in `key`, without a copy beside it, to go on with every contributor \
                 counted as a new one"
            .to_owned(),
    }
}

fn two_keys(root: &Path) -> Error {
    Error::Damaged {
        what: format!("the data directory {}", root.display()),
        reason: "`key` and `key-copy` are sound, but differ. Remove the one that is not this journal's: a backup of \
                 this directory holds the right one"
            .to_owned(),
    }
}
