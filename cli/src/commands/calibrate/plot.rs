//! Clock and yaw over the drive, as SVG.

use std::fmt::Write as _;
use std::path::Path;

use echofix_core::calibration::Estimated;

use super::Look;

/// Width and height of one panel, pixels, with the room for its labels.
const PANEL: [f64; 2] = [640.0, 240.0];
const MARGIN: [f64; 2] = [70.0, 40.0];
/// Colours that stay apart for colour-blind eyes (Okabe and Ito).
const COLOURS: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];

/// One of the figures: its title, and a radar's number with its sigma at a look.
struct Panel {
    title: &'static str,
    value: fn(&Look) -> Estimated,
}

const PANELS: [Panel; 2] = [
    Panel { title: "clock late, ms", value: |look| scaled(look.found.late_s, 1e3) },
    Panel { title: "yaw off, degrees", value: |look| scaled(look.found.yaw_rad, 1_f64.to_degrees()) },
];

fn scaled(e: Estimated, unit: f64) -> Estimated {
    Estimated { value: e.value * unit, sigma: e.sigma * unit }
}

/// Writes what was known of each radar over the drive, with bands of two sigmas.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, looks: &[Look]) -> std::io::Result<()> {
    std::fs::write(path, drawn(looks))
}

fn drawn(looks: &[Look]) -> String {
    let [width, height] = [PANEL[0], PANEL[1] * PANELS.len() as f64];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (row, panel) in PANELS.iter().enumerate() {
        draw(&mut svg, panel, looks, PANEL[1] * row as f64);
    }
    svg.push_str("</svg>\n");
    svg
}

fn draw(svg: &mut String, panel: &Panel, looks: &[Look], top: f64) {
    let ends = |look: &Look| {
        let Estimated { value, sigma } = (panel.value)(look);
        [value - 2.0 * sigma, value + 2.0 * sigma]
    };
    // The first looks know nothing yet: they may leave the panel.
    let settled = looks.iter().skip(looks.len() / 4);
    let [low, high] = settled.fold([-0.5_f64, 0.5_f64], |[low, high], look| {
        let [from, to] = ends(look);
        [low.min(from), high.max(to)]
    });
    let longest_s = looks.iter().map(|look| look.driven_s).fold(1.0, f64::max);
    let x = |s: f64| MARGIN[0] + (PANEL[0] - MARGIN[0] - 20.0) * s / longest_s;
    let y = |v: f64| {
        top + PANEL[1] - MARGIN[1] - (PANEL[1] - 2.0 * MARGIN[1]) * ((v - low) / (high - low)).clamp(0.0, 1.0)
    };
    let (left, right) = (x(0.0), x(longest_s));
    let mut line = |text: std::fmt::Arguments<'_>| {
        // A string takes everything.
        let _ = writeln!(svg, "{text}");
    };
    line(format_args!(
        "<text x=\"{left}\" y=\"{}\">{}, over seconds of driving; bands of two sigmas</text>",
        top + 24.0,
        panel.title
    ));
    for value in [low, 0.0, high] {
        let at = y(value);
        line(format_args!(
            "<path d=\"M{left} {at:.1}H{right}\" stroke=\"#ccc\"/><text x=\"8\" y=\"{:.1}\">{value:.2}</text>",
            at + 4.0
        ));
    }
    line(format_args!(
        "<text x=\"{right}\" y=\"{}\" text-anchor=\"end\">{longest_s:.0} s</text>",
        top + PANEL[1] - 16.0
    ));
    let sensors = looks.iter().map(|look| look.sensor).max().map_or(0, |last| last + 1);
    for sensor in 0..sensors {
        let own = || looks.iter().filter(move |look| look.sensor == sensor);
        let colour = COLOURS[sensor % COLOURS.len()];
        let point = |s: f64, v: f64| format!("{:.1},{:.1} ", x(s), y(v));
        let upper: String = own().map(|look| point(look.driven_s, ends(look)[1])).collect();
        let lower: Vec<_> = own().map(|look| point(look.driven_s, ends(look)[0])).collect();
        let lower: String = lower.into_iter().rev().collect();
        let middle: String = own().map(|look| point(look.driven_s, (panel.value)(look).value)).collect();
        line(format_args!("<polygon points=\"{upper}{lower}\" fill=\"{colour}\" fill-opacity=\"0.15\"/>"));
        line(format_args!(
            "<polyline points=\"{middle}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"
        ));
        let at = left + 70.0 * sensor as f64;
        line(format_args!(
            "<text x=\"{at}\" y=\"{}\" fill=\"{colour}\">radar {sensor}</text>",
            top + PANEL[1] - 16.0
        ));
    }
}
