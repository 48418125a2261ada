//! The records of an MCAP file, one after the other, in bounded memory.
//!
//! A log may hold images of any size beside what is read here. So a record is held only if somebody wants it, and chunks are
//! unpacked as a stream: once to check them, once to read them. What is damaged is told, and the rest is read.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use mcap::MAGIC;
use mcap::records::op;

use super::super::Problem;

/// A record that is wanted is no larger than this; a log's own are far smaller.
const MAX_RECORD: u64 = 16 << 20;
/// Opcode and length of a record.
const HEAD: usize = 9;
/// Channel, number and times of a message.
const MESSAGE_HEAD: usize = 22;
/// Logarithm of what zstd may look back on, bytes: what the format wants every reader to allow. A frame of some bytes can ask
/// for 128 MB.
const MAX_WINDOW_LOG: u32 = 23;
/// The longest name of a way to pack.
const MAX_NAME: u32 = 64;

/// Takes the records of a file.
pub(super) trait Records {
    /// A schema, channel or metadata record.
    fn record(&mut self, opcode: u8, data: &[u8]) -> Result<(), Problem>;
    /// Are the messages of a channel to be held?
    fn wants(&self, channel: u16) -> bool;
    /// A message of such a channel; or an error for one that is larger than any, with its bytes.
    fn message(&mut self, channel: u16, data: Result<&[u8], u64>);
    /// Something that cannot be read, at a byte of the file.
    fn flaw(&mut self, at: u64, problem: &Problem);
}

/// Reads a file to its end, or as far as it goes.
///
/// # Errors
/// When the disk refuses, or it is not an MCAP file (`InvalidData`).
pub(super) fn read(file: File, records: &mut impl Records) -> io::Result<()> {
    let bytes = file.metadata()?.len();
    let mut file = BufReader::new(file);
    let mut magic = [0; MAGIC.len()];
    if file.read_exact(&mut magic).is_err() || magic != *MAGIC {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let mut at = magic.len() as u64;
    loop {
        let mut head = [0; HEAD];
        let (opcode, length) = match file.read_exact(&mut head) {
            Ok(()) => parse_head(head),
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                records.flaw(at, &Problem::CutOff("the end of the data is missing".to_owned()));
                return Ok(());
            }
            Err(e) => return Err(e),
        };
        let end = (at + HEAD as u64).saturating_add(length);
        if matches!(opcode, op::DATA_END | op::FOOTER) {
            return Ok(());
        }
        let known = (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        if end > bytes || !known {
            let problem =
                if known { "a record goes on behind the end" } else { "a record is of no known kind" };
            records.flaw(at, &Problem::CutOff(problem.to_owned()));
            return Ok(());
        }
        match opcode {
            op::CHUNK => match chunk(&mut file, (at, length), records) {
                Ok(()) => {}
                Err(problem) => {
                    records.flaw(at, &Problem::DamagedChunk { bytes: length, problem: problem.to_string() });
                }
            },
            _ => one(&mut file, (at, opcode, length), records)?,
        }
        let here = file.stream_position()?;
        file.seek_relative(end as i64 - here as i64)?;
        at = end;
    }
}

fn parse_head(head: [u8; HEAD]) -> (u8, u64) {
    let [opcode, length @ ..] = head;
    (opcode, u64::from_le_bytes(length))
}

/// Reads a record that is wanted; of another one, nothing or its head. `at` is where it, or its chunk, begins.
fn one(
    from: &mut impl Read,
    (at, opcode, length): (u64, u8, u64),
    records: &mut impl Records,
) -> io::Result<()> {
    match opcode {
        op::SCHEMA | op::CHANNEL | op::METADATA if length <= MAX_RECORD => {
            let data = hold(from, length)?;
            let taken = if lengths_hold(opcode, &data) {
                records.record(opcode, &data)
            } else {
                Err(Problem::Unparsable("a length in it goes on behind its end".to_owned()))
            };
            if let Err(problem) = taken {
                records.flaw(at, &problem);
            }
            Ok(())
        }
        op::MESSAGE if length >= MESSAGE_HEAD as u64 => {
            let mut head = [0; MESSAGE_HEAD];
            from.read_exact(&mut head)?;
            let channel = u16::from_le_bytes([head[0], head[1]]);
            if !records.wants(channel) {
                return Ok(());
            }
            if length > MAX_RECORD {
                records.message(channel, Err(length));
                return Ok(());
            }
            let data = hold(from, length - MESSAGE_HEAD as u64)?;
            records.message(channel, Ok(&data));
            Ok(())
        }
        _ => Ok(()),
    }
}

/// Do the lengths in a schema, channel or metadata record lie within it? The library makes room for what they say before it
/// looks.
fn lengths_hold(opcode: u8, data: &[u8]) -> bool {
    // Numbers of fixed size, then texts and maps, each behind its length in bytes.
    let (fixed, parts) = match opcode {
        op::SCHEMA => (2, 3),
        op::CHANNEL => (4, 3),
        _ => (0, 2),
    };
    let Some(mut rest) = data.get(fixed..) else { return false };
    let mut last = rest;
    for _ in 0..parts {
        let Some((part, after)) = lengthy(rest) else { return false };
        (last, rest) = (part, after);
    }
    if opcode == op::SCHEMA {
        return true;
    }
    // The last one is a map: texts, two and two.
    while !last.is_empty() {
        let Some((_, after)) = lengthy(last) else { return false };
        last = after;
    }
    true
}

/// What stands behind its length, and what comes after it.
fn lengthy(data: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = data.split_first_chunk()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

fn hold(from: &mut impl Read, length: u64) -> io::Result<Vec<u8>> {
    let mut data = Vec::new();
    from.take(length).read_to_end(&mut data)?;
    if (data.len() as u64) < length { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(data) }
}

/// Reads the records of a chunk, which begins at a byte of the file and is so long.
fn chunk(file: &mut BufReader<File>, (at, length): (u64, u64), records: &mut impl Records) -> io::Result<()> {
    let header = ChunkHeader::read(file)?;
    let start = file.stream_position()?;
    let told = |problem: &str| io::Error::other(problem.to_owned());
    if header.packed > length.saturating_sub(header.length) {
        return Err(told("it says that it is longer than it is"));
    }
    let mut checksum = Checksum { hasher: crc32fast::Hasher::new(), bytes: 0 };
    // No more than it says: little may unpack to very much.
    io::copy(&mut header.unpack(file)?.take(header.unpacked.saturating_add(1)), &mut checksum)?;
    let sum = checksum.hasher.finalize();
    if checksum.bytes != header.unpacked || (header.crc != 0 && sum != header.crc) {
        return Err(told("its checksum is wrong"));
    }
    file.seek(SeekFrom::Start(start))?;
    let mut contents = header.unpack(file)?;
    let mut left = header.unpacked;
    while left >= HEAD as u64 {
        let mut head = [0; HEAD];
        contents.read_exact(&mut head)?;
        let (opcode, length) = parse_head(head);
        left -= HEAD as u64;
        left = left.checked_sub(length).ok_or_else(|| told("a record goes on behind its end"))?;
        let mut record = (&mut contents).take(length);
        one(&mut record, (at, opcode, length), records)?;
        io::copy(&mut record, &mut io::sink())?;
    }
    Ok(())
}

struct ChunkHeader {
    unpacked: u64,
    crc: u32,
    packing: String,
    packed: u64,
    /// Bytes of the header itself.
    length: u64,
}

impl ChunkHeader {
    fn read(from: &mut impl Read) -> io::Result<Self> {
        // Two times, the unpacked size, its checksum, and the length of a name.
        let mut fixed = [0; 32];
        from.read_exact(&mut fixed)?;
        let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| fixed[at + i]));
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| fixed[at + i]));
        let name = word(28);
        if name > MAX_NAME {
            return Err(io::Error::other("its header is damaged"));
        }
        let packing = String::from_utf8_lossy(&hold(from, u64::from(name))?).into_owned();
        let mut packed = [0; 8];
        from.read_exact(&mut packed)?;
        let length = 40 + u64::from(name);
        Ok(Self { unpacked: number(16), crc: word(24), packing, packed: u64::from_le_bytes(packed), length })
    }

    /// The contents as a stream.
    fn unpack<'a>(&self, from: &'a mut BufReader<File>) -> io::Result<Box<dyn Read + 'a>> {
        let packed = from.take(self.packed);
        Ok(match self.packing.as_str() {
            "" => Box::new(packed),
            "zstd" => {
                let mut contents = zstd::stream::read::Decoder::with_buffer(packed)?;
                contents.window_log_max(MAX_WINDOW_LOG)?;
                Box::new(contents)
            }
            "lz4" => Box::new(lz4_flex::frame::FrameDecoder::new(packed)),
            other => {
                let told = format!(
                    "it is packed by `{other}`, not by zstd or lz4; `mcap compress` packs a log anew"
                );
                return Err(io::Error::other(told));
            }
        })
    }
}

/// Counts and sums what is written.
struct Checksum {
    hasher: crc32fast::Hasher,
    bytes: u64,
}

impl io::Write for Checksum {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.hasher.update(bytes);
        self.bytes += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
