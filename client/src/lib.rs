//! scaffold
pub mod backoff;
pub mod refusal;
#[cfg(test)]
mod testing;
pub mod wire;
