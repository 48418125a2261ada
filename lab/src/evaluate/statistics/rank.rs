//! Do two quantities rise together, whatever their scale?

/// Spearman's rank correlation of pairs; `None` when there are fewer than two, or all values of one side are equal.
#[must_use]
pub fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let ranks = |value: fn(&(f64, f64)) -> f64| ranks(&pairs.iter().map(value).collect::<Vec<_>>());
    let (a, b) = (ranks(|pair| pair.0), ranks(|pair| pair.1));
    let middle = 0.5 * (pairs.len() as f64 - 1.0);
    let sum = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - middle) * (y - middle)).sum::<f64>();
    let spread = (sum(&a, &a) * sum(&b, &b)).sqrt();
    (spread > 0.0).then(|| sum(&a, &b) / spread)
}

/// Ranks from 0; equal values all get the mean of their ranks.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut ranks = vec![0.0; values.len()];
    let mut from = 0;
    for alike in order.chunk_by(|a, b| values[*a].total_cmp(&values[*b]).is_eq()) {
        let shared = from as f64 + 0.5 * (alike.len() as f64 - 1.0);
        for index in alike {
            ranks[*index] = shared;
        }
        from += alike.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_counts_and_scale_does_not() {
        let grows: Vec<(f64, f64)> = (0..9).map(|k| (f64::from(k), f64::from(k).exp())).collect();
        assert!((correlation(&grows).unwrap() - 1.0).abs() < 1e-12);
        let falls: Vec<_> = grows.iter().map(|(a, b)| (*a, -b)).collect();
        assert!((correlation(&falls).unwrap() + 1.0).abs() < 1e-12);
        // By hand: ranks 0, 1.5, 1.5, 3 against 0, 1, 2, 3.
        let tied = [(1.0, 1.0), (2.0, 2.0), (2.0, 3.0), (5.0, 9.0)];
        assert!((correlation(&tied).unwrap() - 4.5 / 22.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(correlation(&[(1.0, 2.0), (1.0, 3.0)]), None);
        assert_eq!(correlation(&[]), None);
    }
}
