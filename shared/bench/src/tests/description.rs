//! The parameter file and the names of lungs.

use super::all_lungs;
use crate::{
    Bench, BenchConfig, BenchError, BlowerConfig, CompartmentConfig, FaultConfig, LEAST_SUB_STEPS,
    LeakChange, MOST_DELAY_MS, MOST_FAULTS, MOST_LEAK_CHANGES,
};
use shared::link::refusal::Refusal;

fn refused(text: &str) -> String {
    BenchConfig::from_toml(text).unwrap_err().to_string()
}

#[test]
fn every_preset_is_valid_and_round_trips() {
    for mut config in all_lungs() {
        config.lung.second = Some(CompartmentConfig { turbulence_s_per_l: 0.25, ..config.lung.first });
        config.unit.number = u32::MAX;
        config.circuit.leak_changes = vec![LeakChange { at_s: 60.0, leak_l_per_s_at_30_cmh2o: 0.3 }];
        config.flow_sensor.present = false;
        config.blower = Some(BlowerConfig::default());
        config.expiratory.peep_band_cmh2o = Some(2.0);
        assert_eq!(BenchConfig::from_toml(&config.to_toml()).unwrap(), config);
    }
}

#[test]
fn every_preset_comes_back_from_its_bytes() {
    for mut config in all_lungs() {
        config.unit.number = u32::MAX;
        config.circuit.leak_changes = vec![LeakChange { at_s: 60.0, leak_l_per_s_at_30_cmh2o: 0.3 }];
        config.blower = Some(BlowerConfig::default());
        config.faults = faults();
        let bytes = config.to_bytes();
        assert!(bytes.len() < 4_096, "{}", bytes.len());
        assert_eq!(BenchConfig::from_bytes(&bytes).unwrap(), config);
        for end in 0..bytes.len() {
            assert!(BenchConfig::from_bytes(&bytes[..end]).is_err(), "{end} of the bytes");
        }
    }
    let mut wrong = BenchConfig::default();
    wrong.valve.lag_ms = -1.0;
    assert!(matches!(BenchConfig::from_bytes(&wrong.to_bytes()), Err(BenchError::OutOfRange { .. })));
}

/// A fault of every kind that has a form of its own.
fn faults() -> Vec<FaultConfig> {
    let text = "[[faults]]
        from_s = 30
        to_s = 120
        what = { sensor = { signal = \"airway\", distortion = { saturates = { low = 0, high = 50 } } } }
        [[faults]]
        from_s = 60
        repeats = { for_s = 3, every_s = 9 }
        what = { part = { tube_narrowed = 8 } }
        [[faults]]
        from_s = 45
        what = { sensor = { signal = \"flow\", distortion = \"freezes\" } }
        [[faults]]
        from_s = 45
        what = { part = \"supply_lost\" }";
    BenchConfig::from_toml(text).unwrap().faults
}

#[test]
fn what_is_absent_has_its_default() {
    assert_eq!(BenchConfig::from_toml("").unwrap(), BenchConfig::default());
    let config = BenchConfig::from_toml("[lung.first]\nresistance_cmh2o_per_l_s = 7.0").unwrap();
    assert!((config.lung.first.resistance_cmh2o_per_l_s - 7.0).abs() < 1e-12);
    assert!((config.lung.first.compliance_ml_per_cmh2o - 20.0).abs() < 1e-12);
}

#[test]
fn unknown_fields_are_refused_by_name() {
    let tables = [
        "",
        "[valve]",
        "[blower]",
        "[expiratory]",
        "[circuit]",
        "[lung]",
        "[lung.first]",
        "[sensor]",
        "[outlet_sensor]",
        "[flow_sensor]",
        "[unit]",
        "[patient]",
    ];
    for table in tables {
        let message = refused(&format!("{table}\nspeling = 1.0"));
        assert!(message.contains("speling"), "{table}: {message}");
    }
}

/// Every number of the description, by its path.
fn numbers(prefix: &str, table: &toml::Table, found: &mut Vec<String>) {
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => numbers(&format!("{prefix}{key}."), inner, found),
            toml::Value::Float(_) => found.push(format!("{prefix}{key}")),
            _ => {}
        }
    }
}

#[test]
fn every_value_has_bounds_and_the_error_names_the_field() {
    let mut config = BenchConfig::default();
    config.lung.second = Some(CompartmentConfig::default());
    config.blower = Some(BlowerConfig::default());
    config.expiratory.peep_band_cmh2o = Some(2.0);
    let table: toml::Table = toml::from_str(&config.to_toml()).unwrap();
    let mut fields = Vec::new();
    numbers("", &table, &mut fields);
    assert!(fields.len() > 48, "{fields:?}");
    for field in &fields {
        for bad in ["nan", "inf", "-1e9", "1e9"] {
            let mut table = table.clone();
            let (path, key) = field.rsplit_once('.').unwrap();
            let inner = path.split('.').fold(&mut table, |t, part| t[part].as_table_mut().unwrap());
            inner.insert(key.to_owned(), toml::Value::Float(bad.parse().unwrap()));
            let message = refused(&table.to_string());
            assert!(
                message.contains(field.as_str()) && message.contains(" to "),
                "{field} = {bad}: {message}"
            );
        }
    }
}

#[test]
fn changes_of_the_leak_have_bounds_and_an_order() {
    let changes = |list: &str| BenchConfig::from_toml(&format!("[circuit]\nleak_changes = [{list}]"));
    let change = |at_s: &str, leak: &str| format!("{{ at_s = {at_s}, leak_l_per_s_at_30_cmh2o = {leak} }}, ");
    let sorted = changes(&(change("60.0", "0.3") + &change("90.0", "0.0"))).unwrap();
    assert_eq!(sorted.circuit.leak_changes.len(), 2);
    let refused = |list: &str| changes(list).unwrap_err().to_string();
    for second in ["30.0", "60.0"] {
        let message = refused(&(change("60.0", "0.3") + &change(second, "0.1")));
        assert!(message.contains("leak_changes[1].at_s") && message.contains("sort"), "{message}");
    }
    for bad in ["-0.1", "1.1", "nan"] {
        let message = refused(&(change("1.0", "0.3") + &change("2.0", bad)));
        assert!(message.contains("circuit.leak_changes[1].leak_l_per_s_at_30_cmh2o"), "{message}");
    }
    for bad in ["-1.0", "1e7", "nan"] {
        assert!(refused(&change(bad, "0.3")).contains("circuit.leak_changes[0].at_s"), "{bad}");
    }
    assert!(refused("{ at_s = 1.0 }").contains("leak_l_per_s_at_30_cmh2o"), "a change names its leak");
    assert!(refused("{ at_s = 1.0, leak_l_per_s_at_30_cmh2o = 0.1, speling = 1 }").contains("speling"));
}

#[test]
fn too_few_sub_steps_are_refused() {
    assert!(refused("sub_steps = 3").contains("sub_steps = 3 is outside 4 to 64"));
}

#[test]
fn a_peep_the_valve_cannot_be_set_to_is_refused() {
    for peep in [-1.0, 51.0, f32::NAN] {
        let error = Bench::new(&BenchConfig::default(), peep, 1).unwrap_err();
        assert!(error.to_string().starts_with("peep = "), "{error}");
    }
}

#[test]
fn names_find_their_lungs() {
    let rc = |config: &BenchConfig| {
        (config.lung.first.resistance_cmh2o_per_l_s, config.lung.first.compliance_ml_per_cmh2o)
    };
    assert_eq!(BenchConfig::preset("paper").unwrap().len(), 9);
    assert_eq!(BenchConfig::preset("iso").unwrap().len(), 21);
    assert_eq!(rc(&BenchConfig::from_name("R12.5C0.5").unwrap()), (12.5, 0.5));
    assert_eq!(rc(&BenchConfig::from_name("iso-07").unwrap()), (50.0, 10.0));
    assert_eq!(rc(&BenchConfig::preset("iso-21").unwrap()[0]), (200.0, 0.5));
    for config in all_lungs() {
        assert_eq!(BenchConfig::from_name(&config.name).unwrap(), config);
    }
}

#[test]
fn newborns_have_a_machine_of_their_own() {
    let named = |name: &str| BenchConfig::from_name(name).unwrap();
    for name in ["neonate", "neonate-R50C1", "neonate-iso-14"] {
        let bench = named(name);
        assert_eq!(bench.name, name);
        assert!((bench.valve.max_flow_l_per_s - 0.5).abs() < 1e-12, "{name}");
        assert!((bench.circuit.compliance_ml_per_cmh2o - 0.5).abs() < 1e-12, "{name}");
        assert!(
            bench.flow_sensor.noise_sd_l_per_s < 0.2 * BenchConfig::default().flow_sensor.noise_sd_l_per_s
        );
        assert_eq!(BenchConfig::from_toml(&bench.to_toml()).unwrap(), bench);
    }
    let (adult, neonate) = (named("iso-14").lung.first, named("neonate-iso-14").lung.first);
    assert_eq!(adult.resistance_cmh2o_per_l_s.to_bits(), neonate.resistance_cmh2o_per_l_s.to_bits());
    assert_eq!(adult.compliance_ml_per_cmh2o.to_bits(), neonate.compliance_ml_per_cmh2o.to_bits());
    assert!(neonate.turbulence_s_per_l > adult.turbulence_s_per_l, "of the endotracheal tube");
}

#[test]
fn each_row_of_the_table_has_the_machine_that_fits_its_lung() {
    let matched = BenchConfig::preset("iso-matched").unwrap();
    assert_eq!(matched.len(), 21);
    for (number, bench) in (1..).zip(&matched) {
        let neonatal = bench.valve.max_flow_l_per_s < 1.0;
        assert_eq!(neonatal, bench.lung.first.compliance_ml_per_cmh2o <= 3.0, "{}", bench.name);
        let prefix = if neonatal { "neonate-" } else { "" };
        assert_eq!(bench.name, format!("{prefix}iso-{number:02}"));
        assert_eq!(BenchConfig::from_name(&bench.name).unwrap(), *bench);
    }
    assert_eq!(BenchConfig::preset("neonate-iso").unwrap(), matched[8..]);
}

#[test]
fn names_that_mean_nothing_are_refused() {
    for name in [
        "paper",
        "iso",
        "",
        "R20",
        "C20",
        "R20C",
        "RxC2",
        "iso-0",
        "iso-22",
        "r20c20",
        "neonate-",
        "neonate-neonate",
    ] {
        let error = BenchConfig::from_name(name).unwrap_err();
        assert!(matches!(error, BenchError::UnknownName(_)), "{name}: {error}");
    }
    for name in ["R0C20", "R20Cinf", "RnanC20", "R-5C20", "neonate-R0C1"] {
        let error = BenchConfig::from_name(name).unwrap_err();
        assert!(matches!(error, BenchError::OutOfRange { .. }), "{name}: {error}");
    }
}

#[test]
fn files_are_read_and_missing_ones_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bench.toml");
    std::fs::write(&path, BenchConfig::paper(50.0, 10.0).to_toml()).unwrap();
    assert_eq!(BenchConfig::load(&path).unwrap().name, "R50C10");
    let missing = BenchConfig::load(folder.path().join("none.toml")).unwrap_err();
    assert!(missing.to_string().contains("none.toml"));
}

#[test]
fn a_bench_is_found_by_its_lung_or_in_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bench");
    std::fs::write(&path, BenchConfig::paper(50.0, 10.0).to_toml()).unwrap();
    let found = |text: &str| BenchConfig::find(text);
    assert_eq!(found(path.to_str().unwrap()).unwrap(), [BenchConfig::paper(50.0, 10.0)]);
    assert_eq!(found("R5.5C20").unwrap(), [BenchConfig::paper(5.5, 20.0)]);
    assert_eq!(found("paper").unwrap().len(), 9);
    assert!(matches!(found("none.toml"), Err(BenchError::File { .. })));
    assert!(matches!(found("none"), Err(BenchError::UnknownName(_))));
}

/// A chip that refuses a bench says what it takes, and so does the page about it; both stand where the constants cannot be used.
#[test]
fn what_a_chip_takes_is_said_as_it_is() {
    let refusal = Refusal::BadBench.to_string();
    let page = include_str!("../../../../docs/HARDWARE.md").replace('\n', " ");
    for limit in [
        format!("{MOST_FAULTS} faults"),
        format!("{MOST_DELAY_MS} ms"),
        format!("{MOST_LEAK_CHANGES} changes of the leak"),
        format!("{LEAST_SUB_STEPS} sub-steps"),
    ] {
        assert!(refusal.contains(&limit), "{refusal}: {limit}");
        assert!(page.contains(&limit), "{limit}");
    }
}
