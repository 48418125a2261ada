//! A backup: a data directory as a tar archive, made while the store is in use: key, checkpoint, and the journal up
//! to what was on disk when it began. A store that is started on what the archive holds folds the same map.

use std::io::{self, Read, Write};

use crate::store::api::{Error, io_error};
use crate::store::backend::objects::reader;
use crate::store::backend::owner::KEY;
use crate::store::log::journal::BackupPart;
use crate::store::map::context::StoreContext;

const BLOCK: usize = 512;

pub(in crate::store) fn write(shared: &StoreContext, out: &mut dyn Write) -> Result<u64, Error> {
    let parts = parts(shared)?;
    let mut bytes = 0;
    for part in parts {
        bytes += part.length;
        put(out, part).map_err(io_error("writing a backup"))?;
    }
    // Two empty blocks end an archive.
    out.write_all(&[0; 2 * BLOCK]).and_then(|()| out.flush()).map_err(io_error("writing a backup"))?;
    Ok(bytes)
}

/// Opened all at once: what is compacted and deleted later stays readable.
fn parts(shared: &StoreContext) -> Result<Vec<BackupPart>, Error> {
    let checkpoint = shared.checkpoint();
    let opening = "opening what is to be copied";
    let whole = |name: String| {
        let object = shared.backend.objects.open(&name).map_err(io_error(opening))?;
        let length = object.length().map_err(io_error(opening))?;
        Ok::<_, Error>(BackupPart { name, object, length })
    };
    let mut parts = vec![whole(KEY.to_owned())?];
    if let Some(name) = &checkpoint.name {
        parts.push(whole(name.clone())?);
    }
    parts.extend(shared.journal.parts(shared.index.newest_at())?);
    Ok(parts)
}

fn put(out: &mut dyn Write, part: BackupPart) -> io::Result<()> {
    out.write_all(&header(&part.name, part.length))?;
    let copied = io::copy(&mut reader(part.object)?.take(part.length), out)?;
    if copied < part.length {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let padding = (BLOCK - (part.length % BLOCK as u64) as usize) % BLOCK;
    out.write_all(&[0; BLOCK][..padding])
}

/// POSIX.1-1988 ("ustar"): the names are short, and 8 GiB is more than any file here has... but a checkpoint
/// of a continent; GNU's binary sizes, which every tar reads, hold that, too.
fn header(name: &str, length: u64) -> [u8; BLOCK] {
    let mut block = [0; BLOCK];
    block[..name.len()].copy_from_slice(name.as_bytes());
    // The key makes contributors' hashes comparable: only the owner may read it.
    block[100..108].copy_from_slice(b"0000600\0");
    block[108..116].copy_from_slice(b"0000000\0");
    block[116..124].copy_from_slice(b"0000000\0");
    if length < 1 << 33 {
        block[124..136].copy_from_slice(format!("{length:011o}\0").as_bytes());
    } else {
        block[124] = 0x80;
        block[128..136].copy_from_slice(&length.to_be_bytes());
    }
    block[136..148].copy_from_slice(b"00000000000\0");
    block[148..156].fill(b' ');
    block[156] = b'0';
    block[257..265].copy_from_slice(b"ustar\x0000");
    let sum: u32 = block.iter().map(|byte| u32::from(*byte)).sum();
    block[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    block
}
