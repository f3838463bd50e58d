//! Only the safety filter makes a valve command. Code that tries otherwise must not compile, and for the reason that stands
//! beside it in its `.stderr` file: a misspelt name would not compile either.

#[test]
fn no_code_outside_of_safety_makes_or_changes_a_valve_command() {
    trybuild::TestCases::new().compile_fail("tests/valve_command/*.rs");
}
