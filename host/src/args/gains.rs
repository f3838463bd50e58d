//! Gains of a PID as text.

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::{Pid, PidGains};

/// Parses gains: `P,I` or `P,I,D`.
///
/// # Errors
/// Text of another form, or a gain out of its bounds.
pub fn gains(text: &str) -> Result<PidGains, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|part| {
            part.trim().parse().map_err(|_| format!("'{part}' is not a number: write P,I,D as in 2,30,0.01"))
        })
        .collect::<Result<_, _>>()?;
    let gains = match numbers[..] {
        [p, i] => PidGains { p, i, d: 0.0 },
        [p, i, d] => PidGains { p, i, d },
        _ => return Err("write two or three gains P,I,D, such as 2,30,0.01".into()),
    };
    // The period does not matter to the bounds.
    Pid::new(gains, DEFAULT_PERIOD_US).map_err(|error| error.to_string())?;
    Ok(gains)
}

/// Formats gains as the command line accepts them.
pub fn format_gains(gains: &PidGains) -> String {
    let PidGains { p, i, d } = gains;
    format!("{p},{i},{d}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::device::KNOWN_GOOD;

    #[test]
    fn printed_gains_can_be_typed_again() {
        let typed = PidGains { p: 1.25, i: 0.1 + 0.2, d: 0.003 };
        assert_eq!(gains(&format_gains(&typed)), Ok(typed));
    }

    #[test]
    fn a_gain_out_of_its_bounds_is_refused_with_them() {
        for wrong in ["-3,30", "nan,30", "3,inf,0"] {
            assert!(gains(wrong).unwrap_err().contains("allowed are 0 to"), "{wrong}");
        }
    }

    #[test]
    fn the_default_is_the_one_that_the_help_names() {
        assert_eq!(format_gains(&KNOWN_GOOD), "3,30,0");
    }
}
