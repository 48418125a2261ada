//! Points, vectors and segments of the plane.

/// A point or a vector, metres.
pub type Point = [f64; 2];

/// `a - b`.
#[must_use]
pub fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

/// `a + t * v`.
#[must_use]
pub fn add(a: Point, t: f64, v: Point) -> Point {
    [a[0] + t * v[0], a[1] + t * v[1]]
}

/// Scalar product.
#[must_use]
pub fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Signed area spanned: positive when `b` lies counter-clockwise of `a`.
#[must_use]
pub fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Distance, metres.
#[must_use]
pub fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The unit vector from `a` towards `b`; they must differ.
#[must_use]
pub fn direction(a: Point, b: Point) -> Point {
    let length = distance(a, b);
    [(b[0] - a[0]) / length, (b[1] - a[1]) / length]
}

/// The vector turned a quarter to the left.
#[must_use]
pub fn left(v: Point) -> Point {
    [-v[1], v[0]]
}

/// A straight piece between two points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LineSegment {
    /// One end.
    pub a: Point,
    /// The other end.
    pub b: Point,
}

impl LineSegment {
    /// Where the way from `p` to `q` crosses the segment, as a fraction of that way.
    #[must_use]
    pub fn crossing(&self, p: Point, q: Point) -> Option<f64> {
        let (way, along) = (sub(q, p), sub(self.b, self.a));
        let area = cross(way, along);
        if area == 0.0 {
            return None;
        }
        let to_a = sub(self.a, p);
        let (t, u) = (cross(to_a, along) / area, cross(to_a, way) / area);
        ((0.0..=1.0).contains(&t) && (0.0..=1.0).contains(&u)).then_some(t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn point() -> impl Strategy<Value = Point> {
        [-50.0..50.0_f64, -50.0..50.0_f64]
    }

    proptest! {
        #[test]
        fn a_crossing_lies_on_both(a in point(), b in point(), p in point(), q in point()) {
            if let Some(t) = (LineSegment { a, b }).crossing(p, q) {
                let at = add(p, t, sub(q, p));
                let detour = distance(a, at) + distance(at, b) - distance(a, b);
                prop_assert!(detour.abs() < 1e-6, "{detour}");
            }
        }

        #[test]
        fn diagonals_of_a_convex_quadrilateral_cross(w in 1.0..50.0, h in 1.0..50.0_f64) {
            let cross = LineSegment { a: [0.0, 0.0], b: [w, h] }.crossing([w, 0.0], [0.0, h]);
            prop_assert!((cross.unwrap() - 0.5).abs() < 1e-9);
        }
    }
}
