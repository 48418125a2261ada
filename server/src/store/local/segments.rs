//! The journal's segments as files of a directory.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::files;
use crate::store::api::{Error, io_error};
use crate::store::backend::objects::Readable;
use crate::store::backend::segments::{HEADER, Listed, Medium, Segments, first_of, name};

/// A directory of segments.
pub(super) struct LocalSegments(PathBuf);

impl LocalSegments {
    pub(super) fn of(dir: &Path) -> Self {
        Self(dir.to_owned())
    }

    fn path(&self, first: u64) -> PathBuf {
        self.0.join(name(first))
    }
}

impl Segments for LocalSegments {
    fn list(&self) -> io::Result<Vec<Listed>> {
        listed(&self.0)
    }

    fn open(&self, first: u64) -> io::Result<Box<dyn Readable>> {
        Ok(Box::new(File::open(self.path(first))?))
    }

    fn create(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        Ok(Box::new(files::put_new(&self.0, &name(first), |file| file.write_all(header))?))
    }

    fn replace(&self, first: u64, header: &[u8; HEADER]) -> io::Result<Box<dyn Medium>> {
        Ok(Box::new(files::replaced(&self.0, &name(first), header)?))
    }

    fn resume(&self, first: u64) -> io::Result<Box<dyn Medium>> {
        Ok(Box::new(OpenOptions::new().append(true).open(self.path(first))?))
    }

    fn delete(&self, firsts: &[u64]) -> io::Result<()> {
        for first in firsts {
            files::gone(fs::remove_file(self.path(*first)))?;
        }
        files::sync_dir(&self.0)
    }

    fn locate(&self, first: u64) -> String {
        self.path(first).display().to_string()
    }
}

impl Medium for File {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)?;
        self.sync_all()
    }
}

/// Is there any segment?
pub(super) fn any(dir: &Path) -> Result<bool, Error> {
    Ok(dir.is_dir() && !listed(dir).map_err(io_error("listing the journal"))?.is_empty())
}

/// Does a journal hold anything beyond its headers?
pub(super) fn holds_records(dir: &Path) -> Result<bool, Error> {
    let all = listed(dir).map_err(io_error("listing the journal"))?;
    Ok(all.iter().any(|segment| segment.bytes > HEADER as u64))
}

fn listed(dir: &Path) -> io::Result<Vec<Listed>> {
    let mut all = Vec::new();
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        let first = path.file_name().and_then(|name| first_of(name.to_str()?));
        if let Some(first) = first.filter(|_| path.is_file()) {
            all.push(Listed { first, bytes: fs::metadata(&path)?.len() });
        } else {
            tracing::warn!(file = %path.display(), "ignoring a stray file in the journal");
        }
    }
    all.sort_unstable_by_key(|segment| segment.first);
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stray_files_are_left_alone() {
        let dir = tempfile::tempdir().unwrap();
        let segments = LocalSegments::of(dir.path());
        drop(segments.create(1, &[0; HEADER]).unwrap());
        fs::write(dir.path().join("notes.txt"), "hello").unwrap();
        fs::write(dir.path().join("1.seg"), "hello").unwrap();
        assert_eq!(segments.list().unwrap(), [Listed { first: 1, bytes: HEADER as u64 }]);
        assert!(dir.path().join("notes.txt").exists());
    }
}
