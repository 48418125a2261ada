//! Files that are whole or not there, and names that only this store gives.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::store::api::{Error, io_error};

/// Ends the names of files that are being written: nobody else's file has it.
const UNFINISHED: &str = ".echofix-unfinished";

/// Names the file in what is told of a failure.
pub(super) fn at(path: &Path, doing: &'static str) -> impl Fn(io::Error) -> Error {
    let path = path.display().to_string();
    move |error| io_error(doing)(io::Error::new(error.kind(), format!("{path}: {error}")))
}

/// Writes a file that gets its name only when all of it is on disk; the name is on disk, too, when this
/// returns.
pub(super) fn put_file(
    root: &Path,
    name: &str,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    put_file_with(root, name, 0o600, write).map(drop)
}

/// As [`put_file`], with a mode; returns the open file.
pub(super) fn put_file_with(
    root: &Path,
    name: &str,
    mode: u32,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<File> {
    let unnamed = root.join(format!("{name}{UNFINISHED}"));
    let named = |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", unnamed.display()));
    let file = OpenOptions::new().create(true).write(true).truncate(true).mode(mode).open(&unnamed);
    let mut file = BufWriter::new(file.map_err(named)?);
    let finish = |file: &mut BufWriter<File>| {
        write(file)?;
        file.flush()?;
        file.get_ref().sync_all()
    };
    if let Err(error) = finish(&mut file) {
        // Half a file would only take room, on a disk that may have none.
        let _ = fs::remove_file(&unnamed);
        return Err(named(error));
    }
    fs::rename(&unnamed, root.join(name)).map_err(named)?;
    sync_dir(root)?;
    file.into_inner().map_err(io::IntoInnerError::into_error)
}

/// A new file in place of the one of this name: whoever still has that one open writes into nothing.
pub(super) fn replaced(dir: &Path, name: &str, content: &[u8]) -> io::Result<File> {
    drop(put_file_with(dir, name, 0o600, |file| file.write_all(content))?);
    OpenOptions::new().append(true).open(dir.join(name))
}

/// Files that were begun.
static WRITES: AtomicU64 = AtomicU64::new(0);

/// A new file, whole and on disk, with its name; nothing may have that name.
///
/// # Errors
/// [`io::ErrorKind::AlreadyExists`] when something has it, which is left as it is.
pub(super) fn put_new(
    dir: &Path,
    name: &str,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<File> {
    // Asked first, so that nothing large is written in vain.
    if dir.join(name).symlink_metadata().is_ok() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    // Who races for the name writes into a file of its own.
    let unnamed = dir.join(format!("{name}.{}{UNFINISHED}", WRITES.fetch_add(1, Ordering::Relaxed)));
    let put = || {
        let file = OpenOptions::new().create(true).truncate(true).write(true).mode(0o600).open(&unnamed)?;
        let mut file = BufWriter::new(file);
        write(&mut file)?;
        file.into_inner()?.sync_all()?;
        // Unlike a rename, a link takes nothing's place.
        fs::hard_link(&unnamed, dir.join(name))
    };
    let outcome = put();
    let _ = fs::remove_file(&unnamed);
    outcome?;
    let opened = sync_dir(dir).and_then(|()| OpenOptions::new().append(true).open(dir.join(name)));
    opened.inspect_err(|_| _ = fs::remove_file(dir.join(name)))
}

/// As if what is gone already had been removed now.
pub(super) fn gone(removed: io::Result<()>) -> io::Result<()> {
    match removed {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        outcome => outcome,
    }
}

/// Removes the files that were not finished.
pub(super) fn remove_unfinished(root: &Path) -> Result<(), Error> {
    for name in names(root)? {
        let path = root.join(&name);
        if name.ends_with(UNFINISHED) && path.is_file() {
            fs::remove_file(&path).map_err(at(&path, "removing an unfinished file"))?;
        }
    }
    Ok(())
}

pub(super) fn names(root: &Path) -> Result<Vec<String>, Error> {
    names_in(root).map_err(at(root, "listing the data directory"))
}

/// The names in a directory, in order.
pub(super) fn names_in(root: &Path) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(root)? {
        names.extend(entry?.file_name().into_string());
    }
    names.sort_unstable();
    Ok(names)
}

pub(super) fn sync_dir(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}
