//! The network of streets: nodes, centre lines, widths, and the frontages along them.

use super::CityParams;
use crate::plane::{Point, add, cross, direction, distance, dot, left};
use crate::rng::{Purpose, stream, uniform};

/// From the centre line to the middle of a driving lane, metres.
pub const LANE_M: f64 = 1.8;

/// A straight street between two intersections.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Street {
    /// Node at one end.
    pub from: usize,
    /// Node at the other end.
    pub to: usize,
    /// Where `from` lies, city metres.
    pub a: Point,
    /// Where `to` lies, city metres.
    pub b: Point,
    /// From the centre line to the kerb, metres.
    pub kerb_m: f64,
    /// From the centre line to the building fronts, metres.
    pub front_m: f64,
}

impl Street {
    /// Length of the centre line, metres.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        distance(self.a, self.b)
    }
}

/// A line of building fronts; the block lies to the left of the way from `a` to `b`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frontage {
    /// One end, city metres.
    pub a: Point,
    /// The other end, city metres.
    pub b: Point,
}

/// Nodes and streets of the town.
#[derive(Debug, Clone)]
pub struct Network {
    columns: usize,
    rows: usize,
    nodes: Vec<Point>,
    streets: Vec<Street>,
    neighbours: Vec<Vec<(usize, usize)>>,
}

impl Network {
    pub(super) fn generate(params: &CityParams) -> Self {
        let (columns, rows) = (params.blocks_x + 1, params.blocks_y + 1);
        let nodes = nodes(params, columns, rows);
        let mut rng = stream(params.seed, Purpose::Streets, 1, 0);
        let mut streets = Vec::new();
        let mut line = |between: &mut dyn Iterator<Item = (usize, usize)>| {
            let kerb_m = uniform(&mut rng, (6.2, 7.6));
            let front_m = kerb_m + uniform(&mut rng, (2.6, 4.2));
            streets.extend(between.map(|(from, to)| Street {
                from,
                to,
                a: nodes[from],
                b: nodes[to],
                kerb_m,
                front_m,
            }));
        };
        for row in 0..rows {
            line(&mut (1..columns).map(|c| (row * columns + c - 1, row * columns + c)));
        }
        for column in 0..columns {
            line(&mut (1..rows).map(|r| ((r - 1) * columns + column, r * columns + column)));
        }
        Self::joined(columns, rows, nodes, streets)
    }

    /// One straight street along x, its middle at the origin.
    pub(crate) fn straight(length_m: f64, kerb_m: f64, front_m: f64) -> Self {
        let (a, b) = ([-0.5 * length_m, 0.0], [0.5 * length_m, 0.0]);
        Self::joined(2, 1, vec![a, b], vec![Street { from: 0, to: 1, a, b, kerb_m, front_m }])
    }

    /// So many straight streets along x, one north of the other, that nothing joins: street `k` leads from node `2 k`
    /// to node `2 k + 1`. Their middle is the origin.
    pub(crate) fn side_by_side(
        count: usize,
        spacing_m: f64,
        (length_m, kerb_m, front_m): (f64, f64, f64),
    ) -> Self {
        let row = |k: usize| {
            let y = (k as f64 - 0.5 * (count as f64 - 1.0)) * spacing_m;
            [[-0.5 * length_m, y], [0.5 * length_m, y]]
        };
        let nodes: Vec<Point> = (0..count).flat_map(row).collect();
        let street = |k: usize| {
            let (from, to) = (2 * k, 2 * k + 1);
            Street { from, to, a: nodes[from], b: nodes[to], kerb_m, front_m }
        };
        let streets = (0..count).map(street).collect();
        Self::joined(2, count, nodes, streets)
    }

    fn joined(columns: usize, rows: usize, nodes: Vec<Point>, streets: Vec<Street>) -> Self {
        let mut neighbours = vec![Vec::new(); nodes.len()];
        for (index, street) in streets.iter().enumerate() {
            neighbours[street.from].push((street.to, index));
            neighbours[street.to].push((street.from, index));
        }
        Self { columns, rows, nodes, streets, neighbours }
    }

    /// Intersections, city metres.
    #[must_use]
    pub fn nodes(&self) -> &[Point] {
        &self.nodes
    }

    /// Streets between neighbouring intersections.
    #[must_use]
    pub fn streets(&self) -> &[Street] {
        &self.streets
    }

    /// (node, street) pairs that can be reached from a node.
    #[must_use]
    pub fn neighbours(&self, node: usize) -> &[(usize, usize)] {
        &self.neighbours[node]
    }

    /// The street between two nodes, if they are neighbours.
    #[must_use]
    pub fn between(&self, from: usize, to: usize) -> Option<usize> {
        self.neighbours[from].iter().find(|(node, _)| *node == to).map(|(_, street)| *street)
    }

    /// Nodes of every straight line of streets through the town, east-west lines first.
    pub(super) fn lines(&self) -> impl Iterator<Item = Vec<usize>> + '_ {
        let rows = (0..self.rows).map(|r| (0..self.columns).map(|c| r * self.columns + c).collect());
        let columns = (0..self.columns).map(|c| (0..self.rows).map(|r| r * self.columns + c).collect());
        let joined = |line: &Vec<usize>| line.windows(2).all(|w| self.between(w[0], w[1]).is_some());
        rows.chain(columns).filter(move |line: &Vec<usize>| line.len() > 1 && joined(line))
    }

    /// The fronts of all blocks, then those that face the town from outside.
    pub(super) fn frontages(&self) -> Vec<Frontage> {
        let node = |c: usize, r: usize| r * self.columns + c;
        let mut frontages = Vec::new();
        for r in 1..self.rows {
            for c in 1..self.columns {
                frontages.extend(self.inset(&[
                    node(c - 1, r - 1),
                    node(c, r - 1),
                    node(c, r),
                    node(c - 1, r),
                ]));
            }
        }
        let (east, north) = (self.columns - 1, self.rows - 1);
        let clockwise = (0..north).map(|r| node(0, r));
        let clockwise = clockwise.chain((0..east).map(|c| node(c, north)));
        let clockwise = clockwise.chain((1..=north).rev().map(|r| node(east, r)));
        let clockwise: Vec<_> = clockwise.chain((1..=east).rev().map(|c| node(c, 0))).collect();
        frontages.extend(self.inset(&clockwise));
        frontages
    }

    /// The fronts to the left of a closed way along streets.
    fn inset(&self, ring: &[usize]) -> Vec<Frontage> {
        let count = ring.len();
        let side = |k: usize| {
            let (from, to) = (ring[k % count], ring[(k + 1) % count]);
            let normal = left(direction(self.nodes[from], self.nodes[to]));
            let front_m = self.between(from, to).map_or(0.0, |street| self.streets[street].front_m);
            (normal, front_m)
        };
        let corner = |k: usize| {
            let ((n0, w0), (n1, w1)) = (side(k + count - 1), side(k));
            add(self.nodes[ring[k % count]], 1.0, mitre(n0, w0, n1, w1))
        };
        (0..count).map(|k| Frontage { a: corner(k), b: corner(k + 1) }).collect()
    }
}

/// The vector whose components along two unit normals are `w0` and `w1`.
fn mitre(n0: Point, w0: f64, n1: Point, w1: f64) -> Point {
    let area = cross(n0, n1);
    if area.abs() < 0.3 {
        // Nearly one line: the two offsets agree, but their intersection is ill-conditioned.
        let half = 0.5 / (0.5 + 0.5 * dot(n0, n1));
        return [half * (w0 * n0[0] + w1 * n1[0]), half * (w0 * n0[1] + w1 * n1[1])];
    }
    [(w0 * n1[1] - w1 * n0[1]) / area, (w1 * n0[0] - w0 * n1[0]) / area]
}

fn nodes(params: &CityParams, columns: usize, rows: usize) -> Vec<Point> {
    let mut rng = stream(params.seed, Purpose::Streets, 0, 0);
    let most = params.irregularity_m;
    let (s, c) = params.rotation_rad.sin_cos();
    let mut nodes = Vec::with_capacity(columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let x = (column as f64 - 0.5 * (columns - 1) as f64) * params.block_w_m;
            let y = (row as f64 - 0.5 * (rows - 1) as f64) * params.block_h_m;
            let (x, y) = (x + uniform(&mut rng, (-most, most)), y + uniform(&mut rng, (-most, most)));
            nodes.push([c * x - s * y, s * x + c * y]);
        }
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::sub;

    #[test]
    fn the_default_town_has_two_and_a_half_kilometres_of_streets() {
        let network = Network::generate(&CityParams::default());
        assert_eq!(network.nodes().len(), 16);
        assert_eq!(network.streets().len(), 24);
        let length: f64 = network.streets().iter().map(Street::length_m).sum();
        assert!((2400.0..2700.0).contains(&length), "{length}");
    }

    #[test]
    fn fronts_keep_their_distance_from_every_street() {
        let network = Network::generate(&CityParams::default());
        let frontages = network.frontages();
        assert_eq!(frontages.len(), 9 * 4 + 12);
        for street in network.streets() {
            let along = direction(street.a, street.b);
            for Frontage { a, b } in &frontages {
                for p in [*a, *b, add(*a, 0.5, sub(*b, *a))] {
                    let at = dot(sub(p, street.a), along);
                    if (5.0..street.length_m() - 5.0).contains(&at) {
                        let aside = cross(along, sub(p, street.a)).abs();
                        assert!(aside > street.front_m - 0.6, "{aside} < {}", street.front_m);
                    }
                }
            }
        }
    }
}
