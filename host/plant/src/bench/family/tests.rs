//! Tests of the families.

use super::*;
use crate::bench::Bench;

fn ranges(text: &str) -> Result<Family, FamilyError> {
    Family::from_toml(&format!("name = \"test\"\n{text}"))
}

fn refusal(text: &str) -> String {
    ranges(text).unwrap_err().to_string()
}

/// The values of a parameter in 4000 plants, sorted.
fn drawn(range: &str) -> Vec<f64> {
    let family = ranges(&format!("[family.valve]\nlag_ms = {range}")).unwrap();
    let mut values: Vec<f64> = (0..4000).map(|number| family.draw(3, number).valve.lag_ms).collect();
    values.sort_by(f64::total_cmp);
    values
}

#[track_caller]
fn near(value: f64, wanted: f64) {
    assert!((value / wanted - 1.0).abs() < 0.06, "{value}, not {wanted}");
}

#[test]
fn values_are_distributed_as_the_range_says() {
    let uniform = drawn("{ uniform = [10, 50] }");
    for (place, wanted) in [(400, 14.0), (2000, 30.0), (3600, 46.0)] {
        near(uniform[place], wanted);
    }
    let logarithmic = drawn("{ log_uniform = [5, 80] }");
    for (place, wanted) in [(1000, 10.0), (2000, 20.0), (3000, 40.0)] {
        near(logarithmic[place], wanted);
    }
    let normal = drawn("{ normal = [30, 5] }");
    for (place, wanted) in [(635, 25.0), (2000, 30.0), (3365, 35.0)] {
        near(normal[place], wanted);
    }
    assert!(normal[0] >= 15.0 && normal[3999] <= 45.0, "three deviations");
    assert!(uniform[0] >= 10.0 && logarithmic[3999] <= 80.0);
}

#[test]
fn a_plant_depends_on_seed_and_number_alone() {
    let family = Family::find("adult").unwrap();
    assert_eq!(family.draw(1, 7), Family::find("adult").unwrap().draw(1, 7));
    assert_ne!(family.draw(1, 7).valve, family.draw(2, 7).valve);
    assert_ne!(family.draw(1, 7).valve, family.draw(1, 8).valve);
    assert_eq!(family.draw(1, 7).name, "adult-7");
}

#[test]
fn another_range_leaves_all_other_draws_as_they_were() {
    let lag = "[family.valve]\nlag_ms = { uniform = [15, 45] }\n";
    let both = format!("{lag}dead_time_ms = {{ uniform = [8, 20] }}");
    let lags = [lag, &both].map(|text| ranges(text).unwrap().draw(1, 5).valve.lag_ms.to_bits());
    assert_eq!(lags[0], lags[1]);
}

#[test]
fn what_no_range_names_is_as_the_file_says() {
    let family = ranges(
        "[circuit]\ncompliance_ml_per_cmh2o = 0.7\n[family.unit]\nnumber = { uniform = [1, 9] }\n[pid]\np = 1\ni = 2\nd = 0.5\n[soft_pid]\np = 0.5\ni = 1\nd = 0",
    )
    .unwrap();
    let plant = family.draw(1, 0);
    assert!((plant.circuit.compliance_ml_per_cmh2o - 0.7).abs() < 1e-12);
    assert!((1..=9).contains(&plant.unit.number), "a whole number");
    assert_eq!(family.pid, Some(PidGains { p: 1.0, i: 2.0, d: 0.5 }));
    assert_eq!(family.soft_pid, Some(PidGains { p: 0.5, i: 1.0, d: 0.0 }));
}

#[test]
fn a_named_bench_gives_what_the_file_leaves_out() {
    let family = ranges(
        "bench = \"neonate-R50C1\"\n[circuit]\nleak_l_per_s_at_30_cmh2o = 0.01\n[family.valve]\nlag_ms = { uniform = [10, 30] }",
    )
    .unwrap();
    let (plant, named) = (family.draw(1, 0), BenchConfig::from_name("neonate-R50C1").unwrap());
    assert_eq!((plant.lung, plant.sensor, plant.flow_sensor), (named.lung, named.sensor, named.flow_sensor));
    let leak = plant.circuit.leak_l_per_s_at_30_cmh2o;
    assert!((leak - 0.01).abs() < 1e-12 && named.circuit.leak_l_per_s_at_30_cmh2o < 0.01);
    assert!((plant.circuit.compliance_ml_per_cmh2o - named.circuit.compliance_ml_per_cmh2o).abs() < 1e-12);
    assert!(
        refusal("bench = \"frog\"\n[family.valve]\nlag_ms = { uniform = [1, 2] }").contains("unknown lung")
    );
}

#[test]
fn the_waveforms_are_the_papers_unless_the_file_says_otherwise() {
    let range = "[family.valve]\nlag_ms = { uniform = [10, 30] }";
    let paper = ranges(range).unwrap();
    assert_eq!((paper.pips.as_slice(), paper.settings), (&PAPER_PIPS[..], Settings::default()));
    let own =
        ranges(&format!("pips = [12, 18]\n[settings]\nrate = 40\ninspiratory_time = 0.5\n{range}")).unwrap();
    let pips: Vec<f32> = (0..3).map(|number| own.waveform(number).pip).collect();
    assert_eq!(pips, [12.0, 18.0, 12.0]);
    assert_eq!(
        own.waveform(1),
        Settings { pip: 18.0, rate: 40.0, inspiratory_time: 0.5, ..Settings::default() }
    );
    assert!(refusal(&format!("pips = []\n{range}")).starts_with("the family has no waveform"));
    let refused = refusal(&format!("pips = [12, 500]\n{range}"));
    assert!(refused.starts_with("a waveform of the family cannot be run: "), "{refused}");
}

#[test]
fn every_plant_of_a_shipped_family_runs() {
    for name in Family::names() {
        let family = Family::find(name).unwrap();
        assert_eq!(family.name, name);
        for number in 0..50 {
            let mut bench = Bench::new(&family.draw(9, number), 5.0, 1).unwrap();
            assert!((0..500).all(|_| bench.step(30.0, false).is_finite()));
        }
    }
}

#[test]
fn refusals_say_what_to_do() {
    let valve = |range: &str| refusal(&format!("[family.valve]\nlag_ms = {range}"));
    for range in
        ["{ uniform = [9, 3] }", "{ log_uniform = [0, 3] }", "{ normal = [9, -1] }", "{ uniform = [1, inf] }"]
    {
        assert!(valve(range).starts_with("family.valve.lag_ms: the range is empty"), "{}", valve(range));
    }
    for range in ["3", "{ uniform = [1] }", "{ about = [1, 2] }", "{}"] {
        assert!(
            valve(range).contains("lag_ms is no range: write { uniform = [low, high] }"),
            "{}",
            valve(range)
        );
    }
    assert_eq!(
        refusal("[family.valve]\nlagg_ms = { uniform = [1, 2] }"),
        "family.valve.lagg_ms is no number of a bench: see the bench description for the names"
    );
    assert!(refusal("[family.sensors]\nlag_ms = { uniform = [1, 2] }").contains("no number"));
    assert!(refusal("[family.flow_sensor]\npresent = { uniform = [0, 1] }").contains("no number"));
    assert!(valve("{ uniform = [10, 900] }").starts_with("valve.lag_ms = 900 is outside 0 to 500"));
    assert!(
        refusal("[family]").starts_with("the family varies nothing")
            && refusal("").starts_with("the family varies nothing")
    );
    assert!(
        refusal("[family.valve]\nlag_ms = { uniform = [1, 2] }\n[valv]\nlag_ms = 3")
            .starts_with("the family is not valid")
    );
    let unknown = Family::find("aliens").unwrap_err().to_string();
    assert_eq!(unknown, "there is no family aliens: name a TOML file, or one of adult, neonate, blower");
    assert!(
        Family::find("none.toml").unwrap_err().to_string().starts_with("cannot read the family none.toml")
    );
}
