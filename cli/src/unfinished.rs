//! What a command has begun to write, and nobody shall take for a whole: it is removed unless it is finished, when the command fails
//! and when it is interrupted.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// All that is begun and not finished.
static BEGUN: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A file, or a folder, that is being written.
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// Says that a path is being written. Call it where the path did not exist before.
    pub fn begin(path: &Path) -> Self {
        begun().push(path.to_owned());
        Self(path.to_owned())
    }

    /// It is whole, and stays.
    pub fn finish(self) {
        begun().retain(|path| *path != self.0);
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let mut begun = begun();
        if let Some(at) = begun.iter().position(|path| *path == self.0) {
            remove(&begun.swap_remove(at));
        }
    }
}

/// Removes all that is not finished: the command ends, whatever it is at.
pub fn remove_all() {
    begun().drain(..).for_each(|path| remove(&path));
}

fn begun() -> std::sync::MutexGuard<'static, Vec<PathBuf>> {
    BEGUN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn remove(path: &Path) {
    // It may not have come into being.
    let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a part that is left for a whole, and a whole that is removed.
    #[test]
    fn only_what_is_finished_stays() {
        let folder = tempfile::tempdir().unwrap();
        let [whole, part, cut] = ["whole", "part", "cut"].map(|name| folder.path().join(name));
        for path in [&whole, &cut] {
            fs::write(path, "x").unwrap();
        }
        fs::create_dir(&part).unwrap();
        fs::write(part.join("scans.csv"), "x").unwrap();
        Unfinished::begin(&whole).finish();
        drop(Unfinished::begin(&part));
        let going_on = Unfinished::begin(&cut);
        remove_all();
        drop(going_on);
        assert_eq!([&whole, &part, &cut].map(|path| path.exists()), [true, false, false]);
    }
}
