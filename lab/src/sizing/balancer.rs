//! Which replica a region's calls go to.

use echofix_core::geo::RoutingRegion;

/// HAProxy with `balance hdr(x-echofix-region)` and `hash-type consistent`, as docker/haproxy.cfg has it: sdbm, a full
/// avalanche, and on a ring 16 points for each unit of a server's weight; the nearest point on either side counts. It is
/// what `src/lb_chash.c` and `src/backend.c` of 2.6 do; a test holds it to answers of the program itself.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    points: Vec<(u32, usize)>,
}

impl Ring {
    /// The ring of so many servers of one weight, 1 to 256, without one that is down.
    pub fn new(servers: usize, weight: u32, down: Option<usize>) -> Self {
        let of = |server: usize| {
            (0..weight * 16).map(move |node| (avalanche((server as u32 + 1) * 4096 + node), server))
        };
        let mut points: Vec<_> = (0..servers).filter(|server| Some(*server) != down).flat_map(of).collect();
        points.sort_unstable();
        Self { points }
    }

    /// The server of a region; 0 where there is none at all.
    pub fn server(&self, region: RoutingRegion) -> usize {
        self.server_of(&region.to_string())
    }

    fn server_of(&self, header: &str) -> usize {
        let hash = avalanche(header.bytes().fold(0_u32, sdbm));
        let Some(last) = self.points.len().checked_sub(1) else { return 0 };
        let next = self.points.partition_point(|(key, _)| *key < hash);
        let before = self.points[next.checked_sub(1).unwrap_or(last)];
        let after = self.points[if next > last { 0 } else { next }];
        if hash.wrapping_sub(before.0) <= after.0.wrapping_sub(hash) { before.1 } else { after.1 }
    }
}

fn sdbm(hash: u32, byte: u8) -> u32 {
    u32::from(byte).wrapping_add(hash << 6).wrapping_add(hash << 16).wrapping_sub(hash)
}

fn avalanche(a: u32) -> u32 {
    let a = a.wrapping_add(0x7ed5_5d16).wrapping_add(a << 12);
    let a = (a ^ 0xc761_c23c) ^ (a >> 19);
    let a = a.wrapping_add(0x1656_67b1).wrapping_add(a << 5);
    let a = a.wrapping_add(0xd3a2_646c) ^ (a << 9);
    let a = a.wrapping_add(0xfd70_46c5).wrapping_add(a << 3);
    let a = (a ^ 0xb55a_4f09) ^ (a >> 16);
    a.wrapping_mul(3_221_225_473)
}

/// What of each load goes elsewhere where no server may have more than `factor` times the mean (`hash-balance-factor`): the
/// loads after it. The excess goes to those with room, as the ring sends it: to all alike.
pub(super) fn bounded(loads: &[f64], factor: Option<f64>) -> Vec<f64> {
    let Some(factor) = factor else { return loads.to_vec() };
    let alive = loads.iter().filter(|load| **load > 0.0).count().max(1);
    let most = factor * loads.iter().sum::<f64>() / alive as f64;
    let excess: f64 = loads.iter().map(|load| (load - most).max(0.0)).sum();
    let room: f64 = loads.iter().filter(|load| **load > 0.0).map(|load| (most - load).max(0.0)).sum();
    let filled = if room > 0.0 { excess / room } else { 0.0 };
    let after = |load: &f64| if *load > 0.0 { load.min(most) + (most - load).max(0.0) * filled } else { 0.0 };
    loads.iter().map(after).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What HAProxy 2.6.12 answered: `tests/haproxy/picks`.
    const PICKS: [(usize, u32, &str); 3] = [
        (
            3,
            1,
            "01211202122202001012002221221221200221122122010011220201111210212210021220201001102120010220112212001022110201200000200011222020020020221110120102102200211222002222121221002120111012122020022202020102",
        ),
        (
            3,
            100,
            "11110021211220012122000111100100002121200122211012100121012020221021200002221112111211122110020022020112201201120100220001022220002020020202201000110000022022100102122202221211112100210000200000221112",
        ),
        (
            5,
            100,
            "41433431311230312422043111404104402124230124211414100441413024324421300344323112434211422110020042324144201204323100344003024240402023040202201040430300323322100402442233223413114103313000334300221312",
        ),
    ];

    /// Catches: a ring that is not HAProxy's.
    #[test]
    fn it_sends_calls_where_haproxy_sends_them() {
        for (servers, weight, picks) in PICKS {
            let ring = Ring::new(servers, weight, None);
            for (k, pick) in picks.chars().enumerate() {
                let header = format!("326{}/{}/{}", 10 + k % 50, 80 + k % 37, 500 + k % 11);
                assert_eq!(ring.server_of(&header).to_string(), pick.to_string(), "{header}");
            }
        }
    }

    /// Catches: a lost server that moves the regions of others.
    #[test]
    fn a_lost_server_moves_its_own_regions_only() {
        let (all, without) = (Ring::new(8, 100, None), Ring::new(8, 100, Some(3)));
        for x in 0..3000 {
            let header = format!("32614/{x}/511");
            let (before, after) = (all.server_of(&header), without.server_of(&header));
            assert!(after != 3 && (after == before || before == 3), "{header}");
        }
    }

    /// Catches: bounded loads that lose or make calls.
    #[test]
    fn what_is_too_much_for_one_goes_to_others() {
        let loads = [10.0, 2.0, 3.0, 0.0, 1.0];
        let after = bounded(&loads, Some(1.5));
        assert!((after.iter().sum::<f64>() - 16.0).abs() < 1e-9 && after[3] == 0.0);
        assert!(after.iter().all(|load| *load <= 6.0 + 1e-9) && (after[0] - 6.0).abs() < 1e-9);
        assert_eq!(bounded(&loads, None), loads);
    }
}
