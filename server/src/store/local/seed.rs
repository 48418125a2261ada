//! A data directory that begins as a copy of what servers share: the key, what was compacted, and an empty journal behind
//! it.

use std::fs;
use std::io::Write as _;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::Path;

use super::data_dir::{JOURNAL, refuse_foreign};
use super::files::{self, at, put_file};
use super::marker::TILES;
use super::segments;
use crate::store::api::Error;
use crate::store::backend::owner::KEY;
use crate::store::backend::segments::{HEADER, name};

/// Is there a journal in the directory?
///
/// # Errors
/// When the disk refuses.
pub(in crate::store) fn is_begun(root: &Path) -> Result<bool, Error> {
    segments::any(&root.join(JOURNAL))
}

/// Begins a directory in which there is none. The journal is begun last: what a crash leaves is begun again.
///
/// # Errors
/// When the directory is something else's, or lost its journal; or when the disk refuses.
pub(in crate::store) fn begin(
    root: &Path,
    key: &[u8; 16],
    checkpoint: Option<(&str, &[u8])>,
    (first, header): (u64, &[u8; HEADER]),
) -> Result<(), Error> {
    let journal = root.join(JOURNAL);
    let doing = "beginning a copy of the shared map";
    fs::DirBuilder::new().recursive(true).mode(0o700).create(root).map_err(at(root, doing))?;
    refuse_foreign(root)?;
    refuse_opened(root)?;
    fs::DirBuilder::new().recursive(true).mode(0o700).create(&journal).map_err(at(&journal, doing))?;
    put_file(root, KEY, |file| file.write_all(key)).map_err(at(root, doing))?;
    if let Some((name, bytes)) = checkpoint {
        put_file(root, name, |file| file.write_all(bytes)).map_err(at(root, doing))?;
    }
    put_file(&journal, &name(first), |file| file.write_all(header)).map_err(at(&journal, doing))
}

/// Refuses a directory that a service has had open: its journal may lie on a volume that is not mounted. Nothing of what it
/// looks for is made here.
fn refuse_opened(root: &Path) -> Result<(), Error> {
    let opened =
        |name: &&String| ["key-copy", "manifest"].contains(&name.as_str()) || name.starts_with(TILES);
    match files::names(root)?.iter().find(opened) {
        Some(found) => Err(Error::Unusable(format!(
            "{} holds `{found}` and no journal: mount the journal's volume, or name an empty directory, which becomes a copy \
             of what is in the bucket",
            root.display()
        ))),
        None => Ok(()),
    }
}
