//! How the documents write a number.

/// With at most this many decimals, and no zeros at their end.
fn rounded(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if decimals == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// A number, without the noise of single precision.
pub fn number(value: impl Into<f64>) -> String {
    rounded(value.into(), 4)
}

/// A share, in percent.
pub fn percent(share: impl Into<f64>) -> String {
    rounded(100.0 * share.into(), 1)
}

/// A time in seconds, in milliseconds.
pub fn ms(seconds: impl Into<f64>) -> String {
    number(1000.0 * seconds.into())
}

/// A computed number, to a tenth.
pub fn tenths(value: f64) -> String {
    rounded(value, 1)
}

/// A computed number, to a whole one.
pub fn whole(value: f64) -> String {
    rounded(value, 0)
}

/// A number of bytes, with its thousands apart.
pub fn grouped(bytes: u32) -> String {
    let (thousands, rest) = (bytes / 1000, bytes % 1000);
    if thousands == 0 { rest.to_string() } else { format!("{},{rest:03}", grouped(thousands)) }
}

#[test]
fn thousands_are_apart() {
    assert_eq!([64, 6_688, 42_016, 1_000_000].map(grouped), ["64", "6,688", "42,016", "1,000,000"]);
}

#[test]
fn numbers_have_no_noise_and_no_zeros_at_their_end() {
    assert_eq!([number(0.4_f32), number(100_u32), number(-30.0_f32)], ["0.4", "100", "-30"]);
    assert_eq!([percent(1.0_f32 / 3.0), percent(1.0 - 0.9_f32), percent(0.3_f32)], ["33.3", "10", "30"]);
    assert_eq!([ms(0.06_f32), tenths(6.39), whole(73.48), whole(70.0)], ["60", "6.4", "73", "70"]);
}
