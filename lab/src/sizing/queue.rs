//! Fixes that wait for a core: M/M/c with a bounded queue.

/// A replica that computes on so many cores, and lets so many questions wait.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Queue {
    pub cores: u32,
    pub places: u32,
}

/// The queue in its steady state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Waiting {
    /// Offered questions that find no place, of all.
    pub refused: f64,
    /// Probability that a question finds all cores busy and nobody waiting.
    first: f64,
    /// Offered load a core.
    load: f64,
    /// Answers a second that all cores give.
    served_per_s: f64,
    places: u32,
}

impl Queue {
    /// The steady state with so many questions a second, that take so long each in the mean, seconds. It is reached in
    /// some times the mean wait, far below a minute.
    pub fn offered(self, per_s: f64, service_s: f64) -> Waiting {
        let erlangs = per_s * service_s;
        let load = erlangs / f64::from(self.cores);
        // The sum over places of load^place, with place 0.
        let waiting: f64 = (0..=self.places).map(|place| load.powi(place as i32)).sum();
        let busy = loss(erlangs, self.cores);
        let first = if busy > 0.0 { 1.0 / (1.0 / busy + waiting - 1.0) } else { 0.0 };
        let refused = first * load.powi(self.places as i32);
        let served_per_s = f64::from(self.cores) / service_s;
        Waiting { refused, first, load, served_per_s, places: self.places }
    }
}

/// The share of questions that are lost where nobody can wait (Erlang's B), by its recurrence.
fn loss(erlangs: f64, cores: u32) -> f64 {
    (1..=cores).fold(1.0, |blocked, n| erlangs * blocked / (f64::from(n) + erlangs * blocked))
}

impl Waiting {
    /// The probability that an answered question waited at all.
    #[cfg(test)]
    pub fn waits(&self) -> f64 {
        let all: f64 = (0..self.places).map(|place| self.load.powi(place as i32)).sum();
        self.first * all / (1.0 - self.refused).max(f64::MIN_POSITIVE)
    }

    /// The probability that an answered question waited longer than this, seconds. A question that finds so many before
    /// it waits for one answer more than these, and answers come as a Poisson process while all cores are busy.
    pub fn waits_longer(&self, wait_s: f64) -> f64 {
        if self.first < 1e-12 {
            return 0.0;
        }
        let answers = self.served_per_s * wait_s;
        let (mut term, mut at_most, mut sum) = ((-answers).exp(), 0.0, 0.0);
        let mut found = self.first;
        for place in 0..self.places {
            at_most += term;
            sum += found * at_most;
            term *= answers / f64::from(place + 1);
            found *= self.load;
        }
        sum / (1.0 - self.refused).max(f64::MIN_POSITIVE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Catches: a formula that is not that of the textbooks. Erlang's C for 2 cores and a load of 0.8 is 0.711, for 10 and
    /// 0.8 it is 0.409; one core waits with its load, and exp(-(1 - load) t) of these longer than t.
    #[test]
    fn long_queues_are_those_of_the_textbooks() {
        let waits =
            |cores: u32, load: f64| Queue { cores, places: 2000 }.offered(load * f64::from(cores), 1.0);
        assert!((waits(2, 0.8).waits() - 0.7111).abs() < 1e-4);
        assert!((waits(10, 0.8).waits() - 0.4092).abs() < 1e-4);
        let one = waits(1, 0.7);
        for t in [0.0, 0.5, 2.0, 9.0] {
            let textbook = 0.7 * (-0.3_f64 * t).exp();
            assert!((one.waits_longer(t) - textbook).abs() < 1e-9, "{t}");
        }
        // Without places, Erlang's B: 10 cores, 8 erlangs.
        assert!((Queue { cores: 10, places: 0 }.offered(8.0, 1.0).refused - 0.12166).abs() < 1e-4);
    }

    /// Catches: a formula that is not what happens, at overload above all.
    #[test]
    fn it_is_what_a_simulated_queue_does() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for (per_s, cores, places) in [(3.2, 4, 6), (6.0, 4, 6), (0.9, 1, 3)] {
            let queue = Queue { cores, places };
            let expected = queue.offered(per_s, 1.0);
            let mut draw = |rate: f64| -rng.random::<f64>().max(1e-300).ln() / rate;
            let (mut now, mut free_at, mut starts) = (0.0, vec![0.0_f64; cores as usize], Vec::new());
            let (mut refused, mut longer, mut answered) = (0_u32, 0_u32, 0_u32);
            for _ in 0..200_000 {
                now += draw(per_s);
                starts.retain(|start: &f64| *start > now);
                if starts.len() >= places as usize && free_at.iter().all(|at| *at > now) {
                    refused += 1;
                    continue;
                }
                let first = (0..free_at.len()).min_by(|a, b| free_at[*a].total_cmp(&free_at[*b])).unwrap();
                let start = free_at[first].max(now);
                if start > now {
                    starts.push(start);
                }
                free_at[first] = start + draw(1.0);
                answered += 1;
                longer += u32::from(start - now > 0.5);
            }
            let share = |count: u32, all: u32| f64::from(count) / f64::from(all);
            assert!(
                (share(refused, 200_000) - expected.refused).abs() < 0.01,
                "{queue:?}: {expected:?} {refused}"
            );
            assert!(
                (share(longer, answered) - expected.waits_longer(0.5)).abs() < 0.01,
                "{queue:?}: {longer}"
            );
        }
    }
}
