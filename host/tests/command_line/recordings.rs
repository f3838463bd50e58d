//! A third-party table becomes a recording, identified lungs, a bench and a simulator of many lungs.

use std::fmt::Write;

use super::support::Place;

const MAP: &str = r#"
plant = "third-party bench"
[time]
column = "t"
unit = "ms"
[pressure]
column = "Paw"
unit = "hPa"
[u_in]
column = "valve"
unit = "share"
[u_out]
column = "vent"
unit = "percent"
[flow_in]
column = "in"
unit = "L/min"
[flow_out]
column = "out"
unit = "L/min"
[resistance]
column = "R"
[compliance]
column = "C"
[breath]
column = "cycle"
[group]
column = "run"
"#;

const HPA_PER_CMH2O: f64 = 0.980_665;
const LITRES_PER_MINUTE: f64 = 60.0;
/// R (cmH2O/(L/s)) and C (mL/cmH2O) of the runs.
const LUNGS: [(f64, f64); 4] = [(5.0, 20.0), (20.0, 20.0), (20.0, 50.0), (10.0, 10.0)];

/// Breaths of linear lungs at 100 Hz: one second of constant inflow, three of outflow through the same resistor.
fn table() -> String {
    let mut text = "t,Paw,valve,vent,in,out,R,C,cycle,run\n".to_owned();
    let mut tick = 0;
    for (run, (r, c)) in LUNGS.into_iter().enumerate() {
        for breath in 0..7 {
            let valve = 0.2 + 0.04 * f64::from((breath * 3) % 7);
            let mut alveolar = 5.0;
            for row in 0..400 {
                let inspires = row < 100;
                let flow = if inspires { valve } else { -(alveolar - 5.0) / (r + 8.0) };
                let pressure = (alveolar + r * flow) * HPA_PER_CMH2O;
                let (valve, vent) = if inspires { (valve, 0) } else { (0.0, 100) };
                let [inward, outward] = [flow.max(0.0), -flow.min(0.0)].map(|flow| flow * LITRES_PER_MINUTE);
                let time = 10 * tick;
                writeln!(
                    text,
                    "{time},{pressure},{valve},{vent},{inward},{outward},{r},{c},{breath},X:{run}"
                )
                .unwrap();
                alveolar += 10.0 * flow / c;
                tick += 1;
            }
        }
    }
    text
}

fn imported() -> Place {
    let place = Place::new();
    std::fs::write(place.path("table.csv"), table()).unwrap();
    std::fs::write(place.path("map.toml"), MAP).unwrap();
    let summary = place.json("import table.csv --map map.toml --out a.parquet");
    assert_eq!((&summary["rows"], &summary["breaths"]), (&11_200.into(), &28.into()));
    place
}

#[test]
fn lungs_are_identified_and_one_becomes_a_bench() {
    let place = imported();
    let found = place.json("identify a.parquet --write-plant lung.toml --group X:1 --report lungs.html");
    let report = std::fs::read_to_string(place.path("lungs.html")).unwrap();
    assert_eq!(report.matches(">residual, cmH2O</text>").count(), 1);
    assert!(report.contains("trainer evaluate --controller adult --bench lung.toml"));
    let lung = &found["lungs"][0];
    let compliance = lung["compliance"]["value"].as_f64().unwrap();
    assert!((compliance - 20.0).abs() < 0.5, "{found}");
    let scores = place.json("evaluate --bench lung.toml --gains 2,30 --pips 15,30 --breaths 1");
    assert!(scores["mean"]["pid"]["score"].as_f64().unwrap() < 5.0, "{scores}");
    assert!(place.refused("identify a.parquet --write-plant all.toml").contains("--group"));
}

#[test]
fn one_simulator_is_fitted_to_many_lungs_and_judged_on_one_it_never_saw() {
    let place = imported();
    let fit = place.json("fit a.parquet --hold-out-lung 20:50 --epochs 40");
    for key in ["one_step", "open_loop", "open_loop_held_out_lung", "classical_open_loop"] {
        assert!(fit[key].as_f64().unwrap() > 0.0, "{key}: {fit}");
    }
    assert_eq!((&fit["training_breaths"], &fit["held_out_lung_breaths"]), (&18.into(), &7.into()));
    assert!(place.refused("fit a.parquet --hold-out-lung 7:7").contains("20:50"));
}

/// `export.csv.gz | trainer import -`, a pipe by its name, and a proposed map.
#[cfg(unix)]
#[test]
fn a_table_may_come_from_standard_input_or_a_pipe_with_a_proposed_map() {
    let place = Place::new();
    std::fs::write(place.path("table.csv"), table()).unwrap();
    let proposed = place.ok("import table.csv --propose-map proposed.toml");
    assert!(proposed.contains("check each guess") && proposed.contains("saved proposed.toml"), "{proposed}");
    let needs = place.refused("import table.csv --out a.parquet");
    assert!(needs.contains("--map") && needs.contains("--propose-map"), "{needs}");
    std::fs::write(place.path("map.toml"), MAP).unwrap();
    let whole = place.json("import table.csv --map map.toml --out a.parquet");
    let input = std::fs::File::open(place.path("table.csv")).unwrap();
    let mut command = place.command("import - --map map.toml --out b.parquet --json -");
    let output = command.stdin(input).output().unwrap();
    let piped: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(piped, whole);
    let pipe = place.path("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let table = place.path("table.csv");
    let writer = std::thread::spawn(move || std::fs::copy(table, pipe));
    assert_eq!(place.json("import pipe --map map.toml --out c.parquet"), whole);
    writer.join().unwrap().unwrap();
}
