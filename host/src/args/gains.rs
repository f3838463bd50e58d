//! Gains of a PID as text.

use shared::control::pid::PidGains;

/// Parses gains: `P,I` or `P,I,D`.
///
/// # Errors
/// Text of another form.
pub fn gains(text: &str) -> Result<PidGains, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|part| {
            part.trim().parse().map_err(|_| format!("'{part}' is not a number: write P,I,D as in 2,30,0.01"))
        })
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [p, i] => Ok(PidGains { p, i, d: 0.0 }),
        [p, i, d] => Ok(PidGains { p, i, d }),
        _ => Err("write two or three gains P,I,D, such as 2,30,0.01".into()),
    }
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
    fn the_default_is_the_one_that_the_help_names() {
        assert_eq!(format_gains(&KNOWN_GOOD), "3,30,0");
    }
}
