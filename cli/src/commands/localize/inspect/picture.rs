//! A batch over the map, as SVG or as a page.

use std::fmt::Write as _;

use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;

/// Pixels of a side.
const SIDE: f64 = 900.0;

/// A pose to be shown.
pub struct Marker {
    name: String,
    colour: &'static str,
    pose: Pose2,
    /// Half axes along and across the heading, metres.
    pub ellipse_m: Option<[f64; 2]>,
}

impl Marker {
    /// One without an ellipse.
    pub fn pose(name: &str, colour: &'static str, pose: Pose2) -> Self {
        Self { name: name.to_owned(), colour, pose, ellipse_m: None }
    }
}

/// What is drawn: a square of the map, north up.
pub struct Picture {
    pub title: String,
    /// Names and what is to be said of them.
    pub facts: Vec<(&'static str, String)>,
    pub centre: MapPoint,
    pub half_m: f64,
    /// Centres of occupied cells.
    pub map: Vec<MapPoint>,
    /// Detections on the map.
    pub batch: Vec<[f64; 2]>,
    pub markers: Vec<Marker>,
}

impl Picture {
    /// The square, and what is said of it in its title.
    pub fn svg(&self) -> String {
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {SIDE} {SIDE}\" font-family=\"sans-serif\" \
             font-size=\"13\">\n<title>{}</title>\n<rect width=\"{SIDE}\" height=\"{SIDE}\" fill=\"white\"/>\n",
            escaped(&self.title)
        );
        let cells = self.map.iter().map(|cell| [cell.x_m, cell.y_m]);
        self.dots(&mut svg, "map", "#bbbbbb", 1.0, cells);
        self.dots(&mut svg, "batch", "#cc79a7", 2.0, self.batch.iter().copied());
        for marker in &self.markers {
            self.mark(&mut svg, marker);
        }
        self.legend(&mut svg);
        svg.push_str("</svg>\n");
        svg
    }

    /// A page with the square, and all that is said of it.
    pub fn html(&self) -> String {
        let row = |(name, fact): &(&str, String)| {
            ["<tr><th scope=\"row\">", name, "</th><td>", &escaped(fact), "</td></tr>\n"].concat()
        };
        let rows: String = self.facts.iter().map(row).collect();
        format!(
            "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\"><title>{title}</title>\n<style>body{{font:15px \
             sans-serif;margin:1em;max-width:60em}}th{{text-align:left;padding-right:1em;white-space:nowrap}}svg{{max-width:100%}}</style>\n\
             <h1>{title}</h1>\n<table>{rows}</table>\n{}</html>\n",
            self.svg(),
            title = escaped(&self.title)
        )
    }

    fn place(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        let scale = SIDE / (2.0 * self.half_m);
        [SIDE / 2.0 + scale * (x_m - self.centre.x_m), SIDE / 2.0 - scale * (y_m - self.centre.y_m)]
    }

    fn dots(
        &self,
        svg: &mut String,
        class: &str,
        colour: &str,
        side: f64,
        points: impl Iterator<Item = [f64; 2]>,
    ) {
        let _ = write!(svg, "<path class=\"{class}\" fill=\"{colour}\" d=\"");
        for [x, y] in points.map(|point| self.place(point)) {
            if (0.0..=SIDE).contains(&x) && (0.0..=SIDE).contains(&y) {
                let _ = write!(svg, "M{:.1} {:.1}h{side}v{side}h-{side}z", x - side / 2.0, y - side / 2.0);
            }
        }
        svg.push_str("\"/>\n");
    }

    /// An arrow along the heading, and the ellipse.
    fn mark(&self, svg: &mut String, marker: &Marker) {
        let Marker { name, colour, pose, ellipse_m } = marker;
        let [x, y] = self.place([pose.x_m, pose.y_m]);
        let turn = -pose.yaw_rad.to_degrees();
        let _ = write!(
            svg,
            "<g transform=\"translate({x:.2} {y:.2}) rotate({turn:.3})\"><title>{}</title>",
            escaped(name)
        );
        let _ = write!(
            svg,
            "<path d=\"M14 0L-6 5L-6 -5z\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"
        );
        if let Some([along, cross]) = ellipse_m.map(|axes| axes.map(|m| m * SIDE / (2.0 * self.half_m))) {
            let _ = write!(
                svg,
                "<ellipse rx=\"{along:.2}\" ry=\"{cross:.2}\" fill=\"{colour}\" fill-opacity=\"0.15\" stroke=\"{colour}\"/>"
            );
        }
        svg.push_str("</g>\n");
    }

    fn legend(&self, svg: &mut String) {
        let parts = [("map", "#777777"), ("batch at the answer", "#cc79a7")];
        let names = parts.into_iter().chain(self.markers.iter().map(|marker| (&*marker.name, marker.colour)));
        for (row, (name, colour)) in (1..).zip(names) {
            let _ =
                writeln!(svg, "<text x=\"10\" y=\"{}\" fill=\"{colour}\">{}</text>", 18 * row, escaped(name));
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a picture that is mirrored, or leaves out what it is drawn for.
    #[test]
    fn north_is_up_and_all_is_shown() {
        let mut marker =
            Marker::pose("answer <1>", "#0072b2", Pose2::new(100.0, 260.0, std::f64::consts::FRAC_PI_2));
        marker.ellipse_m = Some([2.0, 1.0]);
        let picture = Picture {
            title: "question 1: USABLE".to_owned(),
            facts: vec![("verdict", "all is well & sound".to_owned())],
            centre: MapPoint::new(100.0, 200.0),
            half_m: 90.0,
            map: vec![MapPoint::new(110.0, 200.0), MapPoint::new(1000.0, 200.0)],
            batch: vec![[100.0, 210.0]],
            markers: vec![marker],
        };
        let page = picture.html();
        for part in [
            "M499.5 449.5h1",
            "M449.0 399.0h2",
            "translate(450.00 150.00) rotate(-90.000)",
            "rx=\"10.00\" ry=\"5.00\"",
            "answer &lt;1&gt;",
            "all is well &amp; sound",
        ] {
            assert!(page.contains(part), "{part} is not in {page}");
        }
    }
}
