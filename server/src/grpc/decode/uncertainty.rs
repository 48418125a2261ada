//! How well a prior is known.

use echofix_core::align::combine::sigmas;
use echofix_proto::v1::Prior;

use crate::grpc::invalid_field::{InvalidField, require};

/// Nobody knows where a vehicle is any better; combined with the answer, it would be protected by levels of nothing.
const LEAST_POSITION_M: f64 = 1e-3;
const LEAST_YAW_RAD: f64 = 1e-5;
const TOO_SURE: &str =
    "no prior is known to better than 1 mm and 0.01 mrad; send sigmas in metres and radians";

/// What a prior may be wrong by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Uncertainty {
    /// Of (east m, north m, yaw rad).
    pub covariance: [[f64; 3]; 3],
    /// Sigma of the position along its longest axis, metres.
    pub sigma_position_m: f64,
    /// Sigma of the heading, radians.
    pub sigma_yaw_rad: f64,
}

/// The covariance of a prior, or that of its two sigmas.
///
/// # Errors
/// When neither is a proper uncertainty.
pub fn uncertainty(prior: &Prior) -> Result<Uncertainty, InvalidField> {
    if let [xx, xy, xt, yy, yt, tt] = prior.covariance[..] {
        let covariance = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]];
        let proper = covariance.iter().flatten().all(|v| v.is_finite());
        let (sigma_position_m, sigma_yaw_rad) = sigmas(&covariance)
            .filter(|_| proper)
            .ok_or_else(|| InvalidField::new("prior.covariance", "must be finite and positive definite"))?;
        let least = smallest_axis_m(&covariance);
        let known = least >= LEAST_POSITION_M && sigma_yaw_rad >= LEAST_YAW_RAD;
        require(known, "prior.covariance", &format!("is too small: {TOO_SURE}"))?;
        return Ok(Uncertainty { covariance, sigma_position_m, sigma_yaw_rad });
    }
    let six = "must hold six values, the upper triangle row by row, or none";
    require(prior.covariance.is_empty(), "prior.covariance", six)?;
    let sigma = |value: f64, least: f64, field: &str| {
        require(value.is_finite() && value > 0.0, field, "must be a positive number")?;
        require(value >= least, field, &format!("is too small: {TOO_SURE}"))
    };
    sigma(prior.sigma_position_m, LEAST_POSITION_M, "prior.sigma_position_m")?;
    sigma(prior.sigma_yaw_rad, LEAST_YAW_RAD, "prior.sigma_yaw_rad")?;
    let (position, yaw) = (prior.sigma_position_m.powi(2), prior.sigma_yaw_rad.powi(2));
    Ok(Uncertainty {
        covariance: [[position, 0.0, 0.0], [0.0, position, 0.0], [0.0, 0.0, yaw]],
        sigma_position_m: prior.sigma_position_m,
        sigma_yaw_rad: prior.sigma_yaw_rad,
    })
}

/// Sigma of the position along its shortest axis.
fn smallest_axis_m([[xx, xy, _], [_, yy, _], _]: &[[f64; 3]; 3]) -> f64 {
    (0.5 * (xx + yy) - (0.5 * (xx - yy)).hypot(*xy)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_covariance_stands_for_the_sigmas() {
        let prior = Prior { covariance: vec![4.0, 0.0, 0.0, 1.0, 0.0, 0.01], ..Prior::default() };
        let known = uncertainty(&prior).unwrap();
        assert!((known.sigma_position_m - 2.0).abs() < 1e-12 && (known.sigma_yaw_rad - 0.1).abs() < 1e-12);
        let plain = Prior { sigma_position_m: 2.0, sigma_yaw_rad: 0.1, ..Prior::default() };
        assert!((uncertainty(&plain).unwrap().covariance[1][1] - 4.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_uncertainty_is_refused() {
        let refusal = |covariance: Vec<f64>| {
            let prior = Prior { covariance, sigma_position_m: 2.0, sigma_yaw_rad: 0.1, ..Prior::default() };
            uncertainty(&prior).unwrap_err().to_string()
        };
        assert!(refusal(vec![1.0]).contains("six values"));
        assert!(refusal(vec![1.0, 2.0, 0.0, 1.0, 0.0, 0.01]).contains("positive definite"));
        assert!(refusal(vec![f64::NAN, 0.0, 0.0, 1.0, 0.0, 0.01]).contains("finite"));
        assert!(refusal(vec![1.0, 0.0, 0.0, 1e-18, 0.0, 0.01]).contains("1 mm"));
        assert!(refusal(vec![1.0, 0.0, 0.0, 1.0, 0.0, 1e-18]).contains("0.01 mrad"));
        let sure = Prior { sigma_position_m: 1e-9, sigma_yaw_rad: 0.1, ..Prior::default() };
        assert!(uncertainty(&sure).unwrap_err().to_string().contains("1 mm"));
        let none = Prior::default();
        assert!(uncertainty(&none).unwrap_err().to_string().contains("sigma_position_m"));
    }
}
