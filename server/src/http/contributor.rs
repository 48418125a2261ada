//! Contributors' keyed hashes in words.

/// A contributor's keyed hash, as it is told.
pub fn hash_word(hash: u64) -> String {
    format!("{hash:016x}")
}

/// The keyed hash that is told so.
pub fn parse_hash(word: &str) -> Option<u64> {
    let hex = word.len() == 16 && word.bytes().all(|b| b.is_ascii_hexdigit());
    hex.then(|| u64::from_str_radix(word, 16).ok()).flatten()
}
