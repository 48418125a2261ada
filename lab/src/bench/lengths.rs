//! The cost of a request by the length of its batch: does it grow faster than the batch?

use prost::Message;
use serde::Serialize;

use super::inside::{InProcessService, Inside, detections, timed_of};
use super::town::BenchTown;

/// The cost of requests with batches of one length.
#[derive(Debug, Clone, Serialize)]
pub struct Length {
    /// Length of the batch, seconds.
    pub batch_s: f64,
    /// Number of detections of the median request.
    pub detections: usize,
    /// Mean size of a request, kilobytes.
    pub request_kb: f64,
    /// How long each step takes.
    pub inside: Inside,
}

/// Times requests with batches of every length, each `repetitions` times.
///
/// # Errors
/// When a request is refused.
pub(super) async fn measure(
    parts: &InProcessService,
    town: &BenchTown,
    repetitions: usize,
) -> anyhow::Result<Vec<Length>> {
    let mut lengths = Vec::new();
    for (batch_s, recording) in &town.by_length {
        let requests = timed_of(recording);
        let bytes: usize = requests.iter().map(Message::encoded_len).sum();
        lengths.push(Length {
            batch_s: *batch_s,
            detections: detections(&requests),
            request_kb: bytes as f64 / requests.len().max(1) as f64 / 1e3,
            inside: parts.profile(&requests, repetitions).await?,
        });
    }
    Ok(lengths)
}
