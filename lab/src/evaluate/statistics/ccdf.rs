//! The complementary cumulative distribution: how often is an error exceeded?

/// Number of points on a curve while the fraction falls by a factor of e.
const POINTS_PER_E: usize = 50;

/// (error, fraction of the sample above it), from the smallest error to the largest but one.
pub fn ccdf(sample: impl IntoIterator<Item = f64>) -> Vec<(f64, f64)> {
    let mut sorted: Vec<f64> = sample.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len();
    let point = |index: usize| (sorted[index], (count - 1 - index) as f64 / count as f64);
    // The curve is made for its tail, where steps are small.
    let mut curve = Vec::new();
    let mut index = 0;
    while index + 1 < count {
        curve.push(point(index));
        index += ((count - index) / POINTS_PER_E).max(1);
    }
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_says_what_fraction_lies_above() {
        let sample: Vec<f64> = (0..10_000).map(|k| f64::from(k * 7919 % 10_007)).collect();
        let curve = ccdf(sample.iter().copied());
        assert!(curve.len() < 400 && curve.len() > 100, "{}", curve.len());
        for (error, fraction) in &curve {
            let above = sample.iter().filter(|v| *v > error).count();
            assert!((above as f64 / 10_000.0 - fraction).abs() < 1e-12);
        }
        assert!(curve.is_sorted_by(|a, b| a.0 <= b.0 && a.1 >= b.1));
        assert!((curve[curve.len() - 1].1 - 1e-4).abs() < 1e-9);
        assert!(ccdf([]).is_empty() && ccdf([1.0]).is_empty());
    }
}
