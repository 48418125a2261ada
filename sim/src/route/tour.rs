//! Which nodes a route visits, without turning round on the spot.

use std::collections::VecDeque;

use rand::RngExt;

use crate::city::Network;
use crate::plane::{direction, distance, left};
use crate::rng::{Purpose, stream};

/// Nodes of a way along every street at least once.
///
/// Prefers a street not driven yet; when all around are, takes the way of fewest streets to one.
pub(super) fn survey(network: &Network, seed: u64) -> Vec<usize> {
    let mut rng = stream(seed, Purpose::Tour, 0, 0);
    let mut nodes = vec![rng.random_range(0..network.nodes().len())];
    let mut driven = vec![false; network.streets().len()];
    while driven.contains(&false) {
        let Some(way) = to_nearest_undriven(network, &nodes, &driven, rng.random::<u32>() as usize) else {
            break;
        };
        for node in way {
            if let Some(street) = network.between(nodes[nodes.len() - 1], node) {
                driven[street] = true;
            }
            nodes.push(node);
        }
    }
    nodes
}

/// Nodes to follow up to the end of the nearest undriven street; `salt` decides between equals.
fn to_nearest_undriven(
    network: &Network,
    nodes: &[usize],
    driven: &[bool],
    salt: usize,
) -> Option<Vec<usize>> {
    let mut queue = VecDeque::from([last_two(nodes)]);
    // How each (node, node before it) was reached first.
    let count = network.nodes().len();
    let state = |(at, before): (usize, Option<usize>)| at * (count + 1) + before.map_or(count, |b| b);
    let mut reached = vec![false; count * (count + 1)];
    let mut ways = VecDeque::from([Vec::new()]);
    while let (Some((at, before)), Some(way)) = (queue.pop_front(), ways.pop_front()) {
        let neighbours = network.neighbours(at);
        for k in 0..neighbours.len() {
            let (next, street) = neighbours[(k + salt % neighbours.len()) % neighbours.len()];
            if Some(next) == before || reached[state((next, Some(at)))] {
                continue;
            }
            let mut longer: Vec<usize> = way.clone();
            longer.push(next);
            if !driven[street] {
                return Some(longer);
            }
            reached[state((next, Some(at)))] = true;
            queue.push_back((next, Some(at)));
            ways.push_back(longer);
        }
    }
    None
}

fn last_two(nodes: &[usize]) -> (usize, Option<usize>) {
    let at = nodes.len() - 1;
    (nodes[at], at.checked_sub(1).map(|before| nodes[before]))
}

/// Nodes of a random walk at least `length_m` long; straight on is twice as likely as a turn.
pub(super) fn wander(network: &Network, seed: u64, length_m: f64) -> Vec<usize> {
    let mut rng = stream(seed, Purpose::Tour, 1, 0);
    let mut nodes = vec![rng.random_range(0..network.nodes().len())];
    let mut walked_m = 0.0;
    while walked_m < length_m || nodes.len() < 2 {
        let (at, before) = last_two(&nodes);
        let here = network.nodes()[at];
        let mut choices = Vec::new();
        for (next, _) in network.neighbours(at) {
            let straight = before.is_some_and(|b| {
                let (came, goes) =
                    (direction(network.nodes()[b], here), direction(here, network.nodes()[*next]));
                left(came)[0].mul_add(goes[0], left(came)[1] * goes[1]).abs() < 0.5
            });
            if Some(*next) != before {
                choices.extend(std::iter::repeat_n(*next, if straight { 2 } else { 1 }));
            }
        }
        let next = choices[rng.random_range(0..choices.len())];
        walked_m += distance(here, network.nodes()[next]);
        nodes.push(next);
    }
    nodes
}
