//! The search that uploads are vetted by: coarse to fine, with every second heading and five hills.
//!
//! [`Fast`](super::Fast) misses less. But by how much vetting moves an upload is part of the map, and another search would
//! move it by some millimetres more or less: every map would be folded anew, and every vehicle would download it anew.

use std::cmp::Reverse;

use super::scan::{Around, Scan, halved, width};
use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::simd::Isa;
use crate::align::view::ImageView;
use crate::geo::CELL_M;

/// Points that a scan of all hypotheses counts, at most, or little more. A scan's time is in proportion; a
/// batch of a town has some 3200 points, so it counts every fifth. What that costs is the miss rate.
const SCANNED: usize = 600;
/// Points that the search around a candidate counts, at most, or little more. More than a scan's, for these
/// sums rank the candidates, and only some hundred hypotheses are tried. What it costs is the miss rate.
const SHARPENED: usize = 1000;
/// Hypotheses of a scan of the coarse image beyond which a coarser one is scanned before it. A prior of 2 m
/// and 3 degrees has 18 000 and is scanned at once; one of 4 m has 71 000; 30 m with all headings have
/// eight million.
const MANY: usize = 60_000;
/// Candidates that the coarser image hands on, against the search's five of the coarse one: its pixels
/// are 0.8 m wide, four times the sigma of the smoothing, and order candidates less surely. What it costs is
/// the miss rate.
const FROM_COARSER: usize = 32;
/// Around a candidate of the coarser image, on the coarse one: its pixel is two wide, so that one pixel
/// reaches its border and two more span a neighbour. Turns were scanned by four steps: two steps of two on
/// either side reach the next ones.
const COARSE: Around = Around { pixels: 3, turns: 2, step: 2 };
/// Around a candidate of the coarse image, on the fine one: its pixel is four cells wide, so that two cells
/// reach its border and three more into its neighbours. Turns were scanned by two steps: one on either side
/// is what was left out.
const FINE: Around = Around { pixels: 5, turns: 1, step: 1 };
const _: () = assert!(FINE.fits() && COARSE.fits());

/// The engine.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stepped {
    isa: Option<Isa>,
}

/// Its buffers.
#[derive(Default)]
struct SteppedBuffers {
    scan: Scan,
    coarser: Vec<u8>,
}

impl Stepped {
    /// The engine on the fastest instruction set of this processor.
    pub const BEST: Self = Self { isa: None };

    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa: Some(isa) }
    }
}

impl Engine for Stepped {
    fn name(&self) -> &'static str {
        "stepped"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<SteppedBuffers>();
        buffers.scan.isa = self.isa.unwrap_or_default();
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(question, candidates);
        }
    }
}

impl SteppedBuffers {
    fn search(&mut self, question: &SearchQuestion, candidates: &mut Vec<Candidate>) {
        let coarse = question.view.coarse();
        let count = question.thinned.len();
        let every = |stride: usize| question.thinned.iter().step_by(stride.max(1));
        self.scan.take(every(count / SCANNED));
        if width(question, &coarse).pow(2) * question.lattice.headings() > MANY {
            let coarser = halved(&coarse, &mut self.coarser);
            self.scan.scan(question, &coarser, 4);
            highest(&mut self.scan, question, &coarser, FROM_COARSER, candidates);
            self.scan.take(every(count.div_ceil(SHARPENED)));
            self.scan.sharpen(question, &coarse, &COARSE, candidates);
        } else {
            self.scan.scan(question, &coarse, 2);
            highest(&mut self.scan, question, &coarse, question.search.candidates, candidates);
            self.scan.take(every(count.div_ceil(SHARPENED)));
        }
        self.scan.sharpen(question, &question.view.fine(), &FINE, candidates);
        candidates.truncate(question.search.candidates);
    }
}

/// The highest shifts of the last scan, none within the separation of a higher one, which are forgotten.
fn highest(
    scan: &mut Scan,
    question: &SearchQuestion,
    image: &ImageView,
    most: usize,
    candidates: &mut Vec<Candidate>,
) {
    let width = width(question, image);
    let pixel_m = image.cells as f64 * CELL_M;
    let separation = (question.search.separation_m / pixel_m).powi(2);
    candidates.clear();
    while candidates.len() < most {
        let top = scan.best.iter().enumerate().max_by_key(|(i, sum)| (**sum, Reverse(*i)));
        let Some((index, _)) = top.filter(|(_, sum)| **sum > 0) else { break };
        candidates.push(scan.candidate(question, image, index));
        clear_around(&mut scan.best, index, width, separation);
    }
}

/// Forgets the shifts within the separation of one; `separation` is its square, pixels.
fn clear_around(best: &mut [u32], index: usize, width: usize, separation: f64) {
    let (row, column) = (index / width, index % width);
    let reach = separation.sqrt().ceil() as usize;
    for other_row in row.saturating_sub(reach)..(row + reach + 1).min(width) {
        for other_column in column.saturating_sub(reach)..(column + reach + 1).min(width) {
            let (dr, dc) = (other_row.abs_diff(row), other_column.abs_diff(column));
            if ((dr * dr + dc * dc) as f64) < separation {
                best[other_row * width + other_column] = 0;
            }
        }
    }
}
