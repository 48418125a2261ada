//! The manifest as one file, which is swapped.

use std::fs;
use std::io::{self, Write};
use std::sync::Arc;

use super::data_dir::DataDir;
use super::files::put_file;
use crate::store::api::{Error, io_error};
use crate::store::backend::manifests::Manifests;
use crate::store::backend::owner::Fence as _;

const NAME: &str = "manifest";

/// The file `manifest` of a data directory.
pub(super) struct LocalManifest(pub(super) Arc<DataDir>);

impl Manifests for LocalManifest {
    fn newest(&self) -> Result<Option<Vec<u8>>, Error> {
        let path = self.0.root().join(NAME);
        match fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) if path.is_dir() => {
                tracing::warn!(%error, "there is a directory in the manifest's place");
                Ok(Some(Vec::new()))
            }
            Err(error) => Err(io_error("reading the manifest")(error)),
        }
    }

    fn publish(&self, manifest: &[u8]) -> Result<(), Error> {
        self.0.fence().check()?;
        put_file(self.0.root(), NAME, |file| file.write_all(manifest))
            .map_err(io_error("writing the manifest"))
    }

    fn set_aside(&self, why: &str) -> Result<(), Error> {
        self.0.set_aside(NAME, why)
    }
}
