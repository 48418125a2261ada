//! One request by the length of its batch: whether its cost grows faster than the batch.

use prost::Message;
use serde::Serialize;

use super::inside::{InProcessService, Inside, detections, timed_of};
use super::town::BenchTown;

/// Batches of one length.
#[derive(Debug, Clone, Serialize)]
pub struct Length {
    /// Seconds of scans.
    pub batch_s: f64,
    /// Detections of the median request.
    pub detections: usize,
    /// Mean size of a request, kilobytes.
    pub request_kb: f64,
    /// Where the time goes.
    pub inside: Inside,
}

/// Times requests of every length, so many times each.
///
/// # Errors
/// When a request is refused.
pub(super) async fn measure(
    scene: &InProcessService,
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
            inside: scene.profile(&requests, repetitions).await?,
        });
    }
    Ok(lengths)
}
