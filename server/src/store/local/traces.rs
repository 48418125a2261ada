//! Did this directory hold a map before? A journal that is not there is no reason to begin a new one: it may lie on a
//! volume that is not mounted, or not be restored yet.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::files;
use super::marker::{TILES, marked};
use crate::store::api::Error;

/// # Errors
/// When something in the directory was made from a journal, which is not there.
pub(super) fn none(root: &Path, journal: &Path) -> Result<(), Error> {
    let found: Vec<String> = files::names(root)?.into_iter().filter(|name| is_trace(root, name)).collect();
    if found.is_empty() {
        return Ok(());
    }
    let state = if journal.exists() { "holds no segment" } else { "is not there" };
    Err(Error::Damaged {
        what: format!("the data directory {}", root.display()),
        reason: format!(
            "its journal {} {state}, but {} were made from one. Nothing was changed. If the journal lies on a volume of \
             its own, mount it; else restore the folder `journal` from a backup. To begin an empty map, use another data \
             directory",
            journal.display(),
            found.join(", ")
        ),
    })
}

fn is_trace(root: &Path, name: &str) -> bool {
    let path = root.join(name);
    if name == "manifest" || name.starts_with("base-") {
        return magic(&path).is_some_and(|magic| magic == *b"EFM" || magic == *b"EFB");
    }
    // sled's own file names, for tiles of before there was a marker.
    name.starts_with(TILES) && (marked(&path).is_some() || path.join("db").is_file())
}

fn magic(path: &Path) -> Option<[u8; 3]> {
    let mut magic = [0; 3];
    File::open(path).ok()?.read_exact(&mut magic).ok()?;
    Some(magic)
}
