//! Figures of the report, as SVG.

use std::path::Path;

use anyhow::Context;
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

/// Size of one panel, pixels.
const PANEL: (u32, u32) = (470, 400);
/// Colours that stay apart for colour-blind eyes (Okabe and Ito).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(90, 90, 90),
];

/// A line of a figure.
pub struct Curve {
    /// In the legend.
    pub name: String,
    /// Number of its colour.
    pub colour: usize,
    /// (x, y).
    pub points: Vec<(f64, f64)>,
}

/// One of the figures of a file.
pub struct Panel {
    /// Above it.
    pub title: String,
    /// Along x, with the unit.
    pub x: &'static str,
    /// x reaches so far.
    pub x_max: f64,
    /// The lines.
    pub curves: Vec<Curve>,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Fraction of the epochs above an error, on a logarithmic axis, as in the paper's figures.
///
/// # Errors
/// When the file cannot be written.
pub fn ccdfs(path: &Path, panels: &[Panel]) -> anyhow::Result<()> {
    drawn(path, panels.len(), |areas| {
        for (area, panel) in areas.iter().zip(panels) {
            let mut chart =
                framed(area, &panel.title).build_cartesian_2d(0.0..panel.x_max, (1e-3..1.0).log_scale())?;
            chart
                .configure_mesh()
                .x_desc(panel.x)
                .y_desc("fraction of the epochs above")
                .label_style(("sans-serif", 15))
                .light_line_style(TRANSPARENT)
                .draw()?;
            let clipped = |curve: &Curve| clipped(&curve.points, panel.x_max);
            lines(&mut chart, &panel.curves, clipped)?;
        }
        Ok(())
    })
}

/// What a panel shows of a curve: it runs on to the edge when there are errors beyond.
fn clipped(points: &[(f64, f64)], x_max: f64) -> Vec<(f64, f64)> {
    let beyond = points.partition_point(|(x, _)| *x <= x_max);
    let mut inside = points[..beyond].to_vec();
    if let (Some(&(_, fraction)), true) = (inside.last(), beyond < points.len()) {
        inside.push((x_max, fraction));
    }
    inside.retain(|(_, fraction)| *fraction >= 1e-3);
    inside
}

/// Detections against false alarms.
///
/// # Errors
/// When the file cannot be written.
pub fn rocs(path: &Path, title: &str, curves: &[Curve]) -> anyhow::Result<()> {
    drawn(path, 1, |areas| {
        let mut chart = framed(&areas[0], title).build_cartesian_2d(0.0..1.0, 0.0..1.0)?;
        chart
            .configure_mesh()
            .x_desc("fraction of the right answers refused")
            .y_desc("fraction of the wrong answers refused")
            .label_style(("sans-serif", 15))
            .light_line_style(TRANSPARENT)
            .draw()?;
        lines(&mut chart, curves, |curve| curve.points.clone())
    })
}

/// Errors over the days of a year.
///
/// # Errors
/// When the file cannot be written.
pub fn days(path: &Path, title: &str, curves: &[Curve]) -> anyhow::Result<()> {
    let points = || curves.iter().flat_map(|curve| &curve.points).filter(|(_, y)| y.is_finite());
    let last = points().map(|(day, _)| *day).fold(1.0, f64::max);
    let most = points().map(|(_, error)| *error).fold(0.1, f64::max);
    drawn(path, 1, |areas| {
        // Room above the curves for the legend.
        let mut chart = framed(&areas[0], title).build_cartesian_2d(0.0..1.05 * last, 0.0..1.4 * most)?;
        chart
            .configure_mesh()
            .x_desc("day")
            .y_desc("horizontal error, m")
            .label_style(("sans-serif", 15))
            .light_line_style(TRANSPARENT)
            .draw()?;
        lines(&mut chart, curves, |curve| {
            curve.points.iter().copied().filter(|(_, y)| y.is_finite()).collect()
        })
    })
}

/// Least side of a Stanford diagram's square, metres, and how many bins it has.
const STANFORD: (f64, usize) = (2.0, 80);

/// A Stanford diagram: counts of (error, protection level) pairs; what lies below the diagonal is
/// misleading. Larger values are drawn at the edge.
///
/// # Errors
/// When the file cannot be written.
pub fn stanford(path: &Path, title: &str, pairs: &[(f64, f64)], alert_m: f64) -> anyhow::Result<()> {
    let (least, bins) = STANFORD;
    let most = least.max(1.5 * alert_m);
    let bin = |v: f64| ((v / most * bins as f64) as usize).min(bins - 1);
    let mut counts = vec![0_u32; bins * bins];
    for (error, level) in pairs {
        counts[bin(*level) * bins + bin(*error)] += 1;
    }
    let fullest = f64::from(counts.iter().copied().max().unwrap_or(1).max(1));
    drawn(path, 1, |areas| {
        let mut chart = framed(&areas[0], title).build_cartesian_2d(0.0..most, 0.0..most)?;
        chart
            .configure_mesh()
            .x_desc("horizontal error, m")
            .y_desc("horizontal protection level, m")
            .label_style(("sans-serif", 15))
            .light_line_style(TRANSPARENT)
            .draw()?;
        let step = most / bins as f64;
        let square = |(index, count): (usize, &u32)| {
            let (x, y) = ((index % bins) as f64 * step, (index / bins) as f64 * step);
            let depth = 0.15 + 0.85 * f64::from(*count).ln_1p() / fullest.ln_1p();
            Rectangle::new([(x, y), (x + step, y + step)], COLOURS[0].mix(depth).filled())
        };
        chart.draw_series(counts.iter().enumerate().filter(|(_, count)| **count > 0).map(square))?;
        for line in [
            vec![(0.0, 0.0), (most, most)],
            vec![(0.0, alert_m), (alert_m, alert_m)],
            vec![(alert_m, 0.0), (alert_m, alert_m)],
        ] {
            chart.draw_series(LineSeries::new(line, BLACK))?;
        }
        Ok(())
    })
}

fn framed<'a, 'b>(area: &'a Area<'b>, title: &str) -> ChartBuilder<'a, 'b, SVGBackend<'b>> {
    let mut builder = ChartBuilder::on(area);
    builder.caption(title, ("sans-serif", 20)).margin(12).x_label_area_size(42).y_label_area_size(56);
    builder
}

/// Draws curves and their legend.
fn lines<'a, X, Y>(
    chart: &mut ChartContext<'a, SVGBackend<'a>, Cartesian2d<X, Y>>,
    curves: &[Curve],
    points: impl Fn(&Curve) -> Vec<(f64, f64)>,
) -> anyhow::Result<()>
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64> + AsRangedCoord<CoordDescType = X, Value = f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    for curve in curves {
        let style = COLOURS[curve.colour % COLOURS.len()].stroke_width(2);
        chart
            .draw_series(LineSeries::new(points(curve), style))?
            .label(&curve.name)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], style));
    }
    chart
        .configure_series_labels()
        .label_font(("sans-serif", 14))
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

/// Draws panels, at most two side by side, and writes them.
fn drawn(
    path: &Path,
    panels: usize,
    draw: impl FnOnce(&[Area<'_>]) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut svg = String::new();
    {
        let (columns, rows) = (panels.clamp(1, 2), panels.div_ceil(2).max(1));
        let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root.split_evenly((rows, columns)))?;
        root.present()?;
    }
    std::fs::write(path, svg).with_context(|| format!("writing {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_runs_on_to_the_edge_of_its_panel() {
        let points = [(0.1, 0.5), (0.9, 0.1), (4.0, 0.05), (5.0, 1e-4)];
        assert_eq!(clipped(&points, 1.0), [(0.1, 0.5), (0.9, 0.1), (1.0, 0.1)]);
        assert_eq!(clipped(&points, 6.0), points[..3]);
        assert!(clipped(&[], 1.0).is_empty());
    }

    #[test]
    fn figures_are_written_with_their_curves() {
        let folder = tempfile::tempdir().unwrap();
        let curve = || Curve { name: "a curve".to_owned(), colour: 8, points: vec![(0.1, 0.9), (0.5, 0.01)] };
        let panel = || Panel { title: "T".to_owned(), x: "error, m", x_max: 1.0, curves: vec![curve()] };
        let path = folder.path().join("f.svg");
        let svg = || std::fs::read_to_string(&path).unwrap();
        ccdfs(&path, &[panel(), panel(), panel(), panel()]).unwrap();
        assert!(svg().contains("a curve") && svg().matches("<polyline").count() >= 4);
        assert!(svg().contains("height=\"800\""));
        rocs(&path, "ROC", &[curve()]).unwrap();
        assert!(svg().contains("ROC") && svg().contains("height=\"400\""));
        stanford(&path, "Stanford", &[(0.1, 0.4), (9.0, 9.0)], 0.5).unwrap();
        assert!(svg().contains("Stanford"));
        days(&path, "A year", &[curve()]).unwrap();
        assert!(svg().contains("A year") && svg().contains("a curve"));
        assert!(rocs(&folder.path().join("no/where.svg"), "", &[]).is_err());
    }
}
