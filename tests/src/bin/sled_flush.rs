//! A store as one might write it: records go to sled and are acknowledged once `flush()` returns. The power-cut
//! test shows that it would lose them.
//!
//! `sled_flush write DIR` writes records and prints their numbers, one a line, as they are acknowledged;
//! `sled_flush read DIR` prints the numbers it finds.
#![expect(clippy::print_stdout, reason = "it acknowledges on its standard output")]

use std::error::Error;
use std::io::Write;

const RECORD: usize = 2_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let (what, folder) = (args.next().ok_or("write or read?")?, args.next().ok_or("where?")?);
    let db = sled::open(folder)?;
    let number = |key: &[u8]| key.try_into().map(u64::from_be_bytes).unwrap_or_default();
    if what == "read" {
        for record in db.iter() {
            let (key, value) = record?;
            if value.len() == RECORD {
                println!("{}", number(&key));
            }
        }
        return Ok(());
    }
    let mut next = db.last()?.map_or(0, |(key, _)| number(&key) + 1);
    loop {
        db.insert(next.to_be_bytes(), vec![next as u8; RECORD])?;
        db.flush()?;
        println!("{next}");
        std::io::stdout().flush()?;
        next += 1;
    }
}
