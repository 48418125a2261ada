//! Coarse to fine: every hypothesis on a coarse image with a thinned batch, then the best hills on finer
//! ones.
//!
//! Smoothing makes the map's local maxima wide: the one that is highest on the fine image is among the
//! highest on the coarse one. That is not proven but measured: "Does the fast search find the maximum?"
//! in `docs/benchmarks/search.md` compares the constants below, all together, with the exact maximum. Headings are
//! scanned at every step of the lattice: a step of two misses sharp posts, which at 40 m are passed by within
//! a degree.

use std::cmp::Reverse;

use super::scan::{Around, Counting, Scan, halved, width};
use super::{Candidate, Engine, EngineWorkspace, SearchQuestion};
use crate::align::simd::Isa;
use crate::align::view::ImageView;

/// Hypotheses of a scan of the coarse image beyond which a coarser one is scanned before it. A prior of 2 m
/// and 3 degrees has 18 000 and is scanned at once; one of 4 m has 71 000; 30 m with all headings have
/// eight million.
const MANY: usize = 60_000;
/// Around a candidate of the coarser image, on the coarse one: its pixel is two wide, so that one pixel
/// reaches its border and two more span a neighbour. Turns were scanned by two steps: one on either side is what
/// was left out.
const COARSE: Around = Around { pixels: 3, turns: 1, step: 1 };
/// Around a candidate of the coarse image, on the fine one: its pixel is four cells wide, so that two cells
/// reach its border and three more into its neighbours. A coarse pixel orders headings less surely: one on either
/// side is tried again.
const FINE: Around = Around { pixels: 5, turns: 1, step: 1 };
/// Around what a few points found on the fine image, with more of them.
const FINEST: Around = Around { pixels: 3, turns: 0, step: 1 };
/// Candidates more than asked for that are tried with more points.
const SPARE: usize = 2;
const _: () = assert!(COARSE.fits() && FINE.fits() && FINEST.fits());

/// How much a search counts: its time is in proportion, and what less costs is the miss rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Effort {
    /// Points that a scan of all hypotheses counts, at most, or little more; a batch of a town has some 3200.
    scanned: usize,
    /// Points that the first search around each hill counts.
    sketched: usize,
    /// Points that the last search counts, around the best of them. More than a scan's, for these sums rank the
    /// candidates.
    ranked: usize,
    /// Hills that the coarser image hands on: its pixels are 0.8 m wide, four times the sigma of the
    /// smoothing, and order hills less surely.
    from_coarser: usize,
    /// Hills that the coarse image hands on, whatever the number of candidates that is asked for.
    hills: usize,
    /// Hypotheses beyond which the coarser image comes first.
    many: usize,
}

/// The engine.
#[derive(Debug, Clone, Copy)]
pub struct Fast {
    isa: Option<Isa>,
    effort: Effort,
}

impl Default for Fast {
    fn default() -> Self {
        Self::BEST
    }
}

/// Its buffers.
#[derive(Default)]
struct FastBuffers {
    scan: Scan,
    /// Indices of hills among the shifts of the last scan.
    hills: Vec<usize>,
    /// The highest sum of each shift of the last scan and its neighbours in its row.
    row_highest: Vec<u32>,
    coarser: Vec<u8>,
}

impl Fast {
    /// The engine on the fastest instruction set of this processor.
    pub const BEST: Self = Self {
        isa: None,
        effort: Effort { scanned: 500, sketched: 200, ranked: 1000, from_coarser: 32, hills: 16, many: MANY },
    };

    /// A glance at a wide area: enough to find what looks alike, not to tell how much.
    pub const GLANCE: Self = Self {
        isa: None,
        effort: Effort { scanned: 250, sketched: 200, ranked: 0, from_coarser: 8, hills: 8, many: 0 },
    };

    /// The engine on one instruction set.
    #[must_use]
    pub fn on(isa: Isa) -> Self {
        Self { isa: Some(isa), ..Self::BEST }
    }
}

impl Engine for Fast {
    fn name(&self) -> &'static str {
        "fast"
    }

    fn search_all(
        &self,
        questions: &[SearchQuestion<'_>],
        workspace: &mut EngineWorkspace,
        candidates: &mut [Vec<Candidate>],
    ) {
        let buffers = workspace.buffers::<FastBuffers>();
        buffers.scan.isa = self.isa.unwrap_or_default();
        buffers.scan.counting = Counting::Means;
        for (question, candidates) in questions.iter().zip(candidates) {
            buffers.search(question, &self.effort, candidates);
        }
    }
}

impl FastBuffers {
    fn search(&mut self, question: &SearchQuestion, effort: &Effort, candidates: &mut Vec<Candidate>) {
        let coarse = question.view.coarse();
        let hills = effort.hills.max(question.search.candidates);
        self.take_points(question, effort.scanned);
        if width(question, &coarse).pow(2) * question.lattice.headings() > effort.many {
            let mut image = std::mem::take(&mut self.coarser);
            let coarser = halved(&coarse, &mut image);
            self.scan.scan(question, &coarser, 2);
            self.highest(question, &coarser, effort.from_coarser, candidates);
            // As few as a glance finds are moved on the fine image at once.
            if effort.from_coarser > effort.hills {
                self.sharpen(question, effort.sketched, &coarse, &COARSE, candidates);
            }
            candidates.truncate(hills);
            self.coarser = image;
        } else {
            self.scan.scan(question, &coarse, 1);
            self.highest(question, &coarse, hills, candidates);
        }
        let fine = question.view.fine();
        self.sharpen(question, effort.sketched, &fine, &FINE, candidates);
        candidates.truncate(question.search.candidates + SPARE);
        if effort.ranked > effort.sketched {
            self.sharpen(question, effort.ranked, &fine, &FINEST, candidates);
        }
        candidates.truncate(question.search.candidates);
    }

    /// Takes so many points of the batch, evenly spread, or a few more.
    fn take_points(&mut self, question: &SearchQuestion, most: usize) {
        let stride = (question.thinned.len() / most).max(1);
        self.scan.take(question.thinned.iter().step_by(stride));
    }

    /// The highest hills of the last scan, none within the separation of a higher one.
    fn highest(
        &mut self,
        question: &SearchQuestion,
        image: &ImageView,
        most: usize,
        candidates: &mut Vec<Candidate>,
    ) {
        self.find_hills(width(question, image));
        candidates.clear();
        for &index in &self.hills {
            let hill = self.scan.candidate(question, image, index);
            if is_apart(question, &hill, candidates) {
                candidates.push(hill);
            }
            if candidates.len() == most {
                break;
            }
        }
    }

    /// Shifts of the last scan that no neighbour exceeds, the highest first.
    fn find_hills(&mut self, width: usize) {
        let Self { scan: Scan { best, .. }, hills, row_highest, .. } = self;
        row_highest.clear();
        for row in best.chunks_exact(width) {
            let beside = |x: usize| row[x.saturating_sub(1)].max(row[(x + 1).min(width - 1)]);
            row_highest.extend((0..width).map(|x| row[x].max(beside(x))));
        }
        hills.clear();
        let row_highest = |row: usize| &row_highest[row * width..(row + 1) * width];
        for (row, sums) in best.chunks_exact(width).enumerate() {
            let [south, here, north] =
                [row.saturating_sub(1), row, (row + 1).min(width - 1)].map(row_highest);
            for column in 0..width {
                let highest = south[column].max(here[column]).max(north[column]);
                if sums[column] > 0 && sums[column] == highest {
                    hills.push(row * width + column);
                }
            }
        }
        hills.sort_unstable_by_key(|index| (Reverse(best[*index]), *index));
    }

    /// Moves candidates to the best hypotheses around them on a finer image, counting so many points, and sorts them.
    fn sharpen(
        &mut self,
        question: &SearchQuestion,
        most_points: usize,
        image: &ImageView,
        around: &Around,
        candidates: &mut Vec<Candidate>,
    ) {
        self.take_points(question, most_points);
        self.scan.sharpen(question, image, around, candidates);
        // Those that moved onto the same hill are one: else the flanks of the best one would leave no room for others.
        let mut apart = 0;
        for i in 0..candidates.len() {
            if is_apart(question, &candidates[i], &candidates[..apart]) {
                candidates.swap(apart, i);
                apart += 1;
            }
        }
        candidates.truncate(apart);
    }
}

/// True when a candidate is none of some others: it lies at least the separation from each.
fn is_apart(question: &SearchQuestion, candidate: &Candidate, others: &[Candidate]) -> bool {
    let near =
        |other: &Candidate| other.correction.distance_m(&candidate.correction) < question.search.separation_m;
    !others.iter().any(near)
}
