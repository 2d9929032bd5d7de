//! Small numbers: exact intervals of shares and rates, and percentiles with misses at infinity.

use statrs::distribution::{Beta, ChiSquared, ContinuousCDF};

pub(crate) const CONFIDENCE: f64 = 0.95;

/// Clopper–Pearson interval of a share: exact, two-sided, 95 %. None without trials.
pub fn share_interval(hits: u64, trials: u64) -> Option<[f64; 2]> {
    if trials == 0 {
        return None;
    }
    let tail = (1.0 - CONFIDENCE) / 2.0;
    let (hits, misses) = (hits as f64, (trials - hits) as f64);
    let quantile = |a: f64, b: f64, p: f64| Beta::new(a, b).ok().map(|beta| beta.inverse_cdf(p));
    let low = if hits == 0.0 { 0.0 } else { quantile(hits, misses + 1.0, tail)? };
    let high = if misses == 0.0 { 1.0 } else { quantile(hits + 1.0, misses, 1.0 - tail)? };
    Some([low, high])
}

/// Largest rate per hour that is consistent with `count` Poisson events in `hours`: exact one-sided 95 %
/// bound, 3.0 / hours for no event. None without exposure.
pub fn rate_bound_per_hour(count: u64, hours: f64) -> Option<f64> {
    let chi = ChiSquared::new(2.0 * (count as f64 + 1.0)).ok()?;
    (hours > 0.0).then(|| chi.inverse_cdf(CONFIDENCE) / 2.0 / hours)
}

/// The smallest value that at least the share `p` of the sorted values does not exceed (nearest rank).
/// None where that is infinite, or without values.
pub(crate) fn percentile(sorted: &[f64], p: f64) -> Option<f64> {
    let rank = (p * sorted.len() as f64 - 1e-9).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().filter(|value| value.is_finite())
}

/// Median of sorted values: the mean of the middle two where their number is even. None without values.
pub(crate) fn median_or_infinity(sorted: &[f64]) -> Option<f64> {
    let upper = *sorted.get(sorted.len() / 2)?;
    Some(if sorted.len() % 2 == 1 { upper } else { (sorted[sorted.len() / 2 - 1] + upper) / 2.0 })
}

/// The same; none where it is infinite too.
pub(crate) fn median(sorted: &[f64]) -> Option<f64> {
    median_or_infinity(sorted).filter(|value| value.is_finite())
}

/// None without values.
pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Standard deviation of a sample, with n − 1; none of fewer than two values.
pub(crate) fn standard_deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
    Some((squares / (values.len() - 1) as f64).sqrt())
}

pub(crate) fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: Option<f64>, expected: f64, within: f64) {
        let found = found.unwrap();
        assert!((found - expected).abs() < within, "{found} against {expected}");
    }

    #[test]
    fn known_intervals() {
        // Standard tables of the exact binomial interval.
        let of = |hits, trials, side: usize| share_interval(hits, trials).map(|i| i[side]);
        close(of(100, 100, 0), 0.9638, 1e-4);
        close(of(100, 100, 1), 1.0, 1e-9);
        close(of(95, 100, 0), 0.8872, 1e-4);
        close(of(95, 100, 1), 0.9836, 1e-4);
        close(of(0, 10, 1), 0.3085, 1e-4);
        assert_eq!(share_interval(0, 0), None);
        // No alarm in 10 hours shows no less than 0.3 per hour; 5 in 1 hour: 10.51 (tables).
        close(rate_bound_per_hour(0, 10.0), 0.29957, 1e-4);
        close(rate_bound_per_hour(5, 1.0), 10.513, 1e-3);
        assert_eq!(rate_bound_per_hour(0, 0.0), None);
    }

    #[test]
    fn means_and_deviations() {
        assert_eq!((mean(&[]), standard_deviation(&[])), (None, None));
        assert_eq!((mean(&[3.0]), standard_deviation(&[3.0])), (Some(3.0), None));
        assert_eq!((mean(&[1.0, 2.0, 3.0]), standard_deviation(&[1.0, 2.0, 3.0])), (Some(2.0), Some(1.0)));
    }

    #[test]
    fn percentiles_with_misses() {
        let inf = f64::INFINITY;
        assert_eq!(median(&[1.0, 2.0, inf]), Some(2.0));
        assert_eq!(median(&[1.0, 2.0, 4.0, inf]), Some(3.0));
        assert_eq!(median(&[1.0, inf]), None);
        assert_eq!(median(&[]), None);
        let ten: Vec<f64> = (1..=10).map(f64::from).collect();
        assert_eq!(
            [0.5, 0.76, 0.9, 0.95, 1.0].map(|p| percentile(&ten, p)),
            [5.0, 8.0, 9.0, 10.0, 10.0].map(Some)
        );
        assert_eq!(percentile(&[1.0, inf], 0.9), None);
        assert_eq!(percentile(&[], 0.5), None);
    }
}
