//! From what was found to colour, and to a PNG.

use std::sync::LazyLock;

use serde::Serialize;
use utoipa::ToSchema;

use super::{Layer, Spot};
use crate::http::error::Error;

/// Red, green, blue, opacity.
type Rgba = [u8; 4];

/// Night radar: from deep sea over phosphor to the white of a strong return.
const EVIDENCE: [(u8, Rgba); 6] = [
    (1, [16, 66, 84, 120]),
    (70, [22, 112, 122, 190]),
    (120, [36, 168, 150, 230]),
    (170, [88, 220, 170, 255]),
    (215, [178, 246, 198, 255]),
    (255, [255, 250, 226, 255]),
];

const COVERAGE: [(u8, Rgba); 4] = [
    (1, [30, 58, 110, 60]),
    (120, [44, 98, 178, 105]),
    (220, [84, 150, 236, 150]),
    (255, [132, 184, 255, 170]),
];

/// Days since last seen: fresh is bright and cold, stale is dim and warm.
const AGE: [(u8, [u8; 3]); 5] = [
    (0, [150, 255, 224]),
    (7, [64, 196, 255]),
    (30, [122, 124, 255]),
    (90, [208, 84, 178]),
    (180, [158, 62, 70]),
];

/// Level of a spot where too little stands for a fix.
pub const TOO_LITTLE: u8 = 1;
/// Level of a spot that looks like another one.
pub const AMBIGUOUS: u8 = 40;
/// Sigmas of a fix that is just usable and of one as good as they get, metres, and their levels.
const SIGMAS_M: [f64; 2] = [0.5, 0.1];
const SIGMA_LEVELS: [u8; 2] = [80, 255];

/// Where no fix can be expected is warm, where one can cold, and bright where it is good.
const LOCALIZABILITY: [(u8, Rgba); 6] = [
    (TOO_LITTLE, [158, 62, 70, 150]),
    (AMBIGUOUS, [240, 162, 74, 150]),
    (SIGMA_LEVELS[0], [70, 92, 168, 140]),
    (150, [52, 150, 190, 150]),
    (210, [82, 214, 178, 160]),
    (SIGMA_LEVELS[1], [196, 255, 214, 175]),
];

/// The level of a usable spot by its sigma along the weakest axis: of equal ratios equal steps.
pub fn level_of_sigma(sigma_m: f64) -> u8 {
    let [worst, best] = SIGMAS_M;
    let fraction = ((worst / sigma_m).ln() / (worst / best).ln()).clamp(0.0, 1.0);
    let [low, high] = SIGMA_LEVELS.map(f64::from);
    (low + fraction * (high - low)).round() as u8
}

/// An entry of a layer's legend.
#[derive(Debug, Serialize, ToSchema)]
pub struct LegendEntry {
    /// What the colour stands for.
    pub label: String,
    /// `#rrggbb`
    pub color: String,
}

/// What the colours of a layer stand for.
pub fn legend(layer: Layer) -> Vec<LegendEntry> {
    let entry = |label: &str, color: &[u8]| LegendEntry {
        label: label.to_owned(),
        color: format!("#{:02x}{:02x}{:02x}", color[0], color[1], color[2]),
    };
    let by_level = |labels: &[(&str, u8)], ramp: fn(u8) -> Rgba| {
        labels.iter().map(|(label, level)| entry(label, &ramp(*level))).collect()
    };
    match layer {
        Layer::Evidence => by_level(
            &[("one hit", 60), ("", 120), ("several passes", 170), ("", 215), ("certain", 255)],
            evidence,
        ),
        Layer::Coverage => by_level(&[("few cells", 40), ("", 130), ("many cells", 220)], coverage),
        Layer::Localizability => {
            let no_fix = [("no structure", TOO_LITTLE), ("ambiguous", AMBIGUOUS)];
            let sigmas = [("50 cm", 0.5), ("", 0.32), ("20 cm", 0.2), ("", 0.14), ("10 cm", 0.1)];
            let sigmas = sigmas.map(|(label, sigma_m)| (label, level_of_sigma(sigma_m)));
            by_level(&[&no_fix[..], &sigmas].concat(), localizability)
        }
        Layer::Age => AGE
            .iter()
            .map(|(days, color)| match days {
                0 => entry("today", color),
                180 => entry("180 days +", color),
                days => entry(&format!("{days} days"), color),
            })
            .collect(),
    }
}

fn evidence(level: u8) -> Rgba {
    along(&EVIDENCE, level)
}

fn coverage(level: u8) -> Rgba {
    along(&COVERAGE, level)
}

fn localizability(level: u8) -> Rgba {
    along(&LOCALIZABILITY, level)
}

fn age(spot: Spot, newest_day: u16) -> Rgba {
    let days = newest_day.saturating_sub(spot.day).min(255) as u8;
    let [r, g, b] = along(&AGE, days);
    [r, g, b, 110 + (u16::from(spot.level) * 145 / 255) as u8]
}

/// The colour at a level of a ramp, interpolated.
fn along<const N: usize>(ramp: &[(u8, [u8; N])], at: u8) -> [u8; N] {
    let above = ramp.iter().position(|(stop, _)| *stop >= at).unwrap_or(ramp.len() - 1);
    let (stop_b, b) = ramp[above];
    let (stop_a, a) = ramp[above.saturating_sub(1)];
    if stop_b <= stop_a || at >= stop_b {
        return b;
    }
    let fraction = f32::from(at.saturating_sub(stop_a)) / f32::from(stop_b - stop_a);
    std::array::from_fn(|i| (f32::from(a[i]) + fraction * (f32::from(b[i]) - f32::from(a[i]))).round() as u8)
}

/// A picture of a layer as PNG; `spots` row by row from the north-west.
///
/// # Errors
/// When the encoder refuses, which memory gives no reason for.
pub fn paint(layer: Layer, side: usize, spots: &[Spot], newest_day: u16) -> Result<Vec<u8>, Error> {
    static EVIDENCE_BY_LEVEL: LazyLock<Vec<Rgba>> = LazyLock::new(|| (0..=255).map(evidence).collect());
    let color = |spot: &Spot| match (layer, spot.level) {
        (_, 0) => [0; 4],
        (Layer::Evidence, level) => EVIDENCE_BY_LEVEL[usize::from(level)],
        (Layer::Coverage, level) => coverage(level),
        (Layer::Age, _) => age(*spot, newest_day),
        (Layer::Localizability, level) => localizability(level),
    };
    let pixels: Vec<u8> = spots.iter().flat_map(color).collect();
    encode(side, &pixels).map_err(|e| Error::Internal(format!("a picture could not be encoded: {e}")))
}

fn encode(side: usize, pixels: &[u8]) -> Result<Vec<u8>, png::EncodingError> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, side as u32, side as u32);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    writer.finish()?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ramps_pass_through_their_stops() {
        for (level, color) in EVIDENCE {
            assert_eq!(evidence(level), color);
        }
        assert_eq!(along(&[(0, [0]), (10, [100])], 5), [50]);
        assert_eq!(along(&AGE, 255), [158, 62, 70]);
    }

    #[test]
    fn stronger_is_brighter_and_fresher_is_brighter() {
        let light = |c: &[u8]| 0.2126 * f32::from(c[0]) + 0.7152 * f32::from(c[1]) + 0.0722 * f32::from(c[2]);
        let levels: Vec<f32> = (1..=255).map(|l| light(&evidence(l))).collect();
        assert!(levels.is_sorted());
        let ages: Vec<f32> = AGE.iter().map(|(_, c)| -light(c)).collect();
        assert!(ages.is_sorted());
    }

    #[test]
    fn nothing_is_transparent_in_every_layer() {
        for layer in Layer::ALL {
            let png = paint(layer, 2, &[Spot::NOTHING; 4], 0).unwrap();
            let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
            let mut pixels = vec![1; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut pixels).unwrap();
            assert!(pixels.iter().all(|b| *b == 0));
        }
    }
}
