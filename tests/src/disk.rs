//! A disk whose power can be cut: an ext4 file system on an image file, mounted by a loop device.
//!
//! What the file system has not written to its device is not in the image: a copy of the image is what a
//! disk would hold after a power cut. Needs root and loop devices.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

/// Room for a test's data.
const SIZE: u64 = 256 << 20;
/// Bytes written at once to fill it.
const FILLING: usize = 64 << 10;

/// A mounted image.
pub struct Disk {
    folder: TempDir,
    cuts: u32,
}

impl Disk {
    /// An empty one.
    pub fn new() -> Self {
        Self::of(SIZE)
    }

    /// An empty one of so many bytes.
    pub fn of(bytes: u64) -> Self {
        let disk = Self { folder: tempfile::tempdir().expect("a folder can be made"), cuts: 0 };
        let image = fs::File::create(disk.image()).expect("an image can be made");
        image.set_len(bytes).expect("an image can be made");
        run(Command::new("mkfs.ext4").args(["-q", "-F"]).arg(disk.image()));
        disk.mount();
        disk
    }

    /// Where it is mounted.
    pub fn path(&self) -> PathBuf {
        self.folder.path().join(format!("mounted-{}", self.cuts))
    }

    /// Cuts the power: goes on with what is in the image now.
    pub fn cut(&mut self) {
        let (image, mounted) = (self.image(), self.path());
        self.cuts += 1;
        run(Command::new("cp").arg("--sparse=always").arg(&image).arg(self.image()));
        unmount(&mounted);
        fs::remove_file(image).expect("the old image can be removed");
        self.mount();
    }

    /// Writes until there is no room left.
    pub fn fill(&self) {
        let mut file = fs::File::create(self.filler()).expect("a file can be made");
        for length in [FILLING, 512, 1] {
            while file.write_all(&vec![7; length]).is_ok() {}
        }
        let _ = file.sync_all();
    }

    /// Removes what filled it.
    pub fn free(&self) {
        fs::remove_file(self.filler()).expect("the disk was filled");
    }

    fn filler(&self) -> PathBuf {
        self.path().join("filler")
    }

    fn image(&self) -> PathBuf {
        self.folder.path().join(format!("{}.ext4", self.cuts))
    }

    fn mount(&self) {
        let at = self.path();
        fs::create_dir(&at).expect("a folder can be made");
        // A file system that commits on its own now and then would hide what nobody has synced.
        run(Command::new("mount").args(["-o", "loop,commit=600"]).arg(self.image()).arg(at));
    }
}

impl Default for Disk {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        unmount(&self.path());
    }
}

fn unmount(at: &Path) {
    // Lazily: a process that was killed may still be letting go of it.
    let _ = Command::new("umount").arg("--lazy").arg(at).status();
}

fn run(command: &mut Command) {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?} cannot be run: {error}"));
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?} failed (it needs root and loop devices): {stderr}");
}
