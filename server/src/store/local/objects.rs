//! Objects as files of a directory.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::files;
use crate::store::backend::objects::{Objects, Readable};

/// The files that lie in a directory, but for those in folders.
pub(super) struct LocalObjects(PathBuf);

impl LocalObjects {
    pub(super) fn of(dir: &Path) -> Self {
        Self(dir.to_owned())
    }
}

impl Objects for LocalObjects {
    fn put_new(&self, name: &str, write: &mut dyn FnMut(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        files::put_new(&self.0, name, |file| write(file)).map(drop)
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Readable>> {
        Ok(Box::new(File::open(self.0.join(name))?))
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<String>> {
        let mut names = files::names_in(&self.0)?;
        names.retain(|name| name.starts_with(prefix) && self.0.join(name).is_file());
        Ok(names)
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        files::gone(fs::remove_file(self.0.join(name)))
    }

    fn locate(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }
}

impl Readable for File {
    fn length(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        self.read_exact_at(out, at)
    }
}
