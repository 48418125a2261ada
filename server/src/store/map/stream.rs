//! Checksummed streams of tiles: what a checkpoint and a region's file are made of.
//!
//! ```text
//! tile     EPSG code (4) | x (4) | y (4) | version (8) | length (4) | encoded tile
//! trailer  CRC-32C of all before it (4)
//! ```
//!
//! All little-endian.

use std::io::{self, Read, Write};

use echofix_core::geo::{TileId, Zone};

/// No encoded tile comes near this many bytes.
const MAX_TILE: u32 = 256 << 20;

/// A stream being written.
pub(in crate::store) struct ChecksummedWriter<W> {
    inner: W,
    sum: u32,
}

impl<W: Write> ChecksummedWriter<W> {
    pub(in crate::store) fn new(inner: W) -> Self {
        Self { inner, sum: 0 }
    }

    pub(in crate::store) fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sum = crc32c::crc32c_append(self.sum, bytes);
        self.inner.write_all(bytes)
    }

    pub(in crate::store) fn tile(&mut self, id: TileId, version: u64, encoded: &[u8]) -> io::Result<()> {
        self.put(&u32::from(id.zone.epsg()).to_le_bytes())?;
        self.put(&id.x.to_le_bytes())?;
        self.put(&id.y.to_le_bytes())?;
        self.put(&version.to_le_bytes())?;
        self.put(&(encoded.len() as u32).to_le_bytes())?;
        self.put(encoded)
    }

    /// Ends the stream with its checksum.
    pub(in crate::store) fn end(mut self) -> io::Result<()> {
        self.inner.write_all(&self.sum.to_le_bytes())?;
        self.inner.flush()
    }
}

/// A stream being read. Nothing of it may be used before [`ChecksummedReader::end`] agreed.
pub(in crate::store) struct ChecksummedReader<R> {
    inner: R,
    sum: u32,
}

impl<R: Read> ChecksummedReader<R> {
    pub(in crate::store) fn new(inner: R) -> Self {
        Self { inner, sum: 0 }
    }

    pub(in crate::store) fn array<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.inner.read_exact(&mut bytes)?;
        self.sum = crc32c::crc32c_append(self.sum, &bytes);
        Ok(bytes)
    }

    pub(in crate::store) fn number(&mut self) -> io::Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub(in crate::store) fn tile(&mut self) -> io::Result<(TileId, u64, Vec<u8>)> {
        let zone = Zone::from_epsg(u32::from_le_bytes(self.array()?));
        let zone = zone.map_err(|_| bad("it names a zone that does not exist"))?;
        let (x, y) = (i32::from_le_bytes(self.array()?), i32::from_le_bytes(self.array()?));
        let version = self.number()?;
        let length = u32::from_le_bytes(self.array()?);
        if length > MAX_TILE {
            return Err(bad("a tile in it is larger than any can be"));
        }
        let mut encoded = Vec::new();
        // Grows with what is really there, whatever the length says.
        if (&mut self.inner).take(u64::from(length)).read_to_end(&mut encoded)? < length as usize {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.sum = crc32c::crc32c_append(self.sum, &encoded);
        Ok((TileId { zone, y, x }, version, encoded))
    }

    /// Checks the trailer, and that nothing follows.
    pub(in crate::store) fn end(mut self) -> io::Result<()> {
        let sum = self.sum;
        let expected = u32::from_le_bytes(self.array()?);
        if sum != expected {
            return Err(bad("its checksum does not match"));
        }
        match self.inner.read(&mut [0])? {
            0 => Ok(()),
            _ => Err(bad("something follows its end")),
        }
    }
}

/// What is wrong with the content.
pub(in crate::store) fn bad(reason: &'static str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, reason)
}
