//! Whole farms of simulated devices at ports, with the faults that farms have.

mod switch;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::description::{Farm, Place, Unit};
use super::*;
use data::recording::Recording;
use data::workspace::WorkspaceError;
use device::Device;
use device::port::Address;
use device::simulated::{MOST_PACE, Served};
use learn::controller::shipped;
use plant::bench::BenchConfig;
use plant::locked;
use progress::Event;
use shared::settings::Settings;
use shared::ventilator::Mode;
use switch::Switch;
use ventilator::collect::COLLECT;

/// Breaths of a recording.
const BREATHS: usize = 10;

/// A bench whose sensor reads this much at no pressure, and whose valve has this dead time.
fn bench(lung: &str, sensor_offset: f64, dead_time_ms: f64) -> BenchConfig {
    let mut bench = BenchConfig::from_name(lung).unwrap();
    bench.valve.dead_time_ms = dead_time_ms;
    // The offset of unit 1 of this spread; its flow and its dead time are nominal.
    (bench.unit.number, bench.unit.flow_gain_sd_percent, bench.unit.dead_time_sd_ms) = (1, 0.0, 0.0);
    bench.unit.sensor_offset_sd_cmh2o = 0.3;
    let drawn = offset_of(&bench);
    bench.unit.sensor_offset_sd_cmh2o *= (sensor_offset / drawn).abs();
    assert!((offset_of(&bench) - sensor_offset.abs() * drawn.signum()).abs() < 0.1);
    bench
}

/// What the sensor of a bench reads at no pressure: a reading of the bench at rest.
fn offset_of(bench: &BenchConfig) -> f64 {
    use plant::Plant;
    let mut plant = plant::bench::BenchPlant::new(bench).unwrap();
    let mut sum = f64::from(plant.reset(1000, 1, 0.0).unwrap().pressure);
    for _ in 1..1000 {
        sum += f64::from(plant.step(0.0, true).unwrap().pressure);
    }
    sum / 1000.0
}

fn at(name: &str, address: &Address) -> Unit {
    Unit {
        name: name.parse().unwrap(),
        place: Place::Port(address.clone()),
        lung: None,
        note: String::new(),
        sensor_gain: None,
        line: format!("farm.toml:{name}"),
    }
}

fn farm(units: Vec<Unit>) -> Farm {
    Farm { units, band: Band::default() }
}

/// A small farm's run.
struct Small<'a> {
    farm: &'a Farm,
    out: &'a Path,
    until: FarmStage,
    simulators: Simulators,
    recalibrate: bool,
    adopt: Vec<UnitName>,
}

impl<'a> Small<'a> {
    fn new(farm: &'a Farm, out: &'a Path, until: FarmStage) -> Self {
        Self { farm, out, until, simulators: Simulators::Each, recalibrate: false, adopt: Vec::new() }
    }

    fn run(&self) -> Result<FarmResult, StudyError> {
        self.watched(&Progress::silent())
    }

    fn watched(&self, progress: &Progress<'_>) -> Result<FarmResult, StudyError> {
        let start = shipped::residual("adult").unwrap();
        let pips = [15.0, 25.0];
        let mut run =
            CommissionRun { parts: 2, drawn: (64, 32), ..CommissionRun::of(&Settings::default(), &pips) };
        run.collect.breaths = BREATHS;
        run.fit.epochs = 120;
        (run.train.iterations, run.train.batch, run.train.validate_every) = (20, 64, 10);
        FarmRun {
            farm: self.farm,
            config: FarmConfig {
                run,
                farm_iterations: 20,
                simulators: self.simulators,
                breaths_of_learning: 1,
                scored_breaths: 1,
            },
            start: ("adult", &start),
            out: self.out.to_owned(),
            adopt: self.adopt.clone(),
            recalibrate: self.recalibrate,
            until: self.until,
            patience: Duration::from_secs(2),
            pace: MOST_PACE,
            sign: &Ok,
            tell: &|_, _| (),
        }
        .run(progress)
    }
}

/// The recording of a unit, which must have every breath once, whole and in order.
fn whole_recording(out: &Path, unit: &str) -> Recording {
    let recording =
        Recording::load(out.join(format!("units/{unit}/measurement-0/recording.parquet"))).unwrap();
    let breaths = recording.breaths();
    assert_eq!(breaths.len(), BREATHS);
    for (number, rows) in breaths.into_iter().enumerate() {
        assert!(recording.breath[rows.clone()].iter().all(|breath| *breath as usize == number));
        assert!(recording.tick[rows].iter().copied().eq(0..3000));
    }
    recording
}

fn pips(recording: &Recording) -> Vec<f32> {
    recording.breaths().into_iter().map(|rows| recording.pip[rows.start]).collect()
}

#[test]
fn a_farm_records_trains_flashes_and_compares_every_controller_on_every_unit() {
    let folder = tempfile::tempdir().unwrap();
    let benches = [bench("R20C20", 0.4, 12.0), bench("R20C50", 0.1, 12.0), bench("R50C20", 0.2, 19.0)];
    let served = benches.each_ref().map(|bench| Served::start(bench, MOST_PACE).unwrap());
    let units = served.iter().enumerate().map(|(n, served)| at(&(n + 1).to_string(), served.address()));
    let farm = farm(units.collect());
    let result = Small::new(&farm, folder.path(), FarmStage::Flash).run().unwrap();
    for (unit, bench) in result.units.iter().zip(&benches) {
        assert_eq!((unit.problem.as_ref(), unit.breaths), (None, BREATHS));
        let calibration = unit.calibration.unwrap();
        assert!((f64::from(calibration.sensor_zero) - offset_of(bench)).abs() < 0.05, "{calibration:?}");
        assert!(
            (f64::from(calibration.dead_time_ms) - bench.valve.dead_time_ms).abs() < 3.0,
            "{calibration:?}"
        );
    }
    let [outside] = &result.outside[..] else { panic!("{:?}", result.outside) };
    assert_eq!(outside.unit.as_str(), "3");
    assert!(outside.message.starts_with("dead time "), "{}", outside.message);
    let matrix = result.matrix.as_ref().unwrap();
    let rows: Vec<&str> = matrix.rows.iter().map(|row| row.controller.as_str()).collect();
    assert_eq!(rows, ["known-good PID", "adult", "farm", "of unit 1", "of unit 2", "of unit 3"]);
    assert!(matrix.rows.iter().all(|row| row.scores.iter().all(|score| score.is_some_and(|s| s > 0.3))));
    for (place, unit) in result.units.iter().enumerate() {
        let (best, _) = matrix.best(place).unwrap();
        assert_eq!(unit.weights_id, best.weights_id, "each unit runs the controller that is best on it");
    }
    for (served, unit) in served.iter().zip(&result.units) {
        let mut device = Device::connect(served.address()).unwrap();
        let running = device.identify().unwrap().running_id().map(|id| format!("{id:08x}"));
        assert_eq!((running.is_some(), running), (true, unit.weights_id.clone()));
        assert_eq!(device.calibration(0).unwrap().1, unit.calibration);
    }
    let html = report::report(&result).to_html().unwrap();
    assert!(html.contains("of unit 3") && html.contains("dead time"), "the report shows matrix and band");
    // The same call finds everything done.
    let again = Small::new(&farm, folder.path(), FarmStage::Flash).run().unwrap();
    assert_eq!(again.matrix, result.matrix);
    assert_eq!(again.units[0].calibration, result.units[0].calibration);
}

#[test]
fn a_unit_whose_plug_is_pulled_continues_where_it_was_and_no_breath_is_lost_or_doubled() {
    let folder = tempfile::tempdir().unwrap();
    let served = [
        Served::start(&bench("R20C20", 0.1, 12.0), MOST_PACE).unwrap(),
        Served::start(&bench("R20C20", 0.1, 12.0), MOST_PACE).unwrap(),
    ];
    let switch = Switch::start(served[0].address());
    let farm = farm(vec![at("1", switch.address()), at("2", served[1].address())]);
    let (pulled, never) = (Mutex::new(Vec::new()), AtomicBool::new(false));
    let observer = |event: &Event<'_>| {
        // At its third and at its seventh breath.
        if event.subject == "1" && [3, 7].contains(&event.done) && !locked(&pulled).contains(&event.done) {
            locked(&pulled).push(event.done);
            switch.pull();
        }
    };
    let result = Small::new(&farm, folder.path(), FarmStage::Collect)
        .watched(&Progress::new(&observer, &never))
        .unwrap();
    assert_eq!(*locked(&pulled), [3, 7]);
    let [first, second] = &result.units[..] else { panic!("{result:?}") };
    assert_eq!((first.problem.as_ref(), second.problem.as_ref()), (None, None));
    assert!(first.sessions >= 3, "{} sessions", first.sessions);
    assert_eq!(second.sessions, 1, "the other unit was not disturbed");
    let recording = whole_recording(folder.path(), "1");
    whole_recording(folder.path(), "2");
    assert_eq!(recording.provenance.groups[0].to_string(), "1:measurement-0");
    let straight = tempfile::tempdir().unwrap();
    let direct = Farm { units: vec![at("1", served[0].address())], ..farm.clone() };
    Small::new(&direct, straight.path(), FarmStage::Collect).run().unwrap();
    assert_eq!(
        pips(&recording),
        pips(&whole_recording(straight.path(), "1")),
        "the PIPs of an unbroken recording"
    );
}

#[test]
fn a_unit_that_does_not_answer_stops_no_other_one() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(&bench("R20C20", 0.1, 12.0), MOST_PACE).unwrap();
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let farm = farm(vec![at("absent", &Address::Tcp(nobody.to_string())), at("2", served.address())]);
    let result = Small::new(&farm, folder.path(), FarmStage::Collect).run().unwrap();
    assert!(result.units[0].problem.as_ref().is_some_and(|problem| problem.contains("cannot connect")));
    assert_eq!((result.units[1].problem.as_ref(), result.units[1].breaths), (None, BREATHS));
    whole_recording(folder.path(), "2");
}

#[test]
fn a_unit_that_is_no_board_on_the_desk_cannot_simulate_a_bench() {
    let folder = tempfile::tempdir().unwrap();
    let lung = bench("R20C20", 0.1, 12.0);
    let served = Served::start(&lung, MOST_PACE).unwrap();
    let place = Place::Desk(served.address().clone(), Box::new(lung));
    let farm = farm(vec![Unit { place, ..at("1", served.address()) }]);
    let refused = Small::new(&farm, folder.path(), FarmStage::Contact).run().unwrap_err().to_string();
    assert!(refused.contains("farm.toml:1: unit 1 at tcp:"), "{refused}");
    assert!(refused.contains("does not simulate the bench: "), "{refused}");
}

#[test]
fn a_unit_that_answers_as_another_is_refused_with_its_line_and_nothing_moves() {
    let folder = tempfile::tempdir().unwrap();
    let served = [0.1, 0.4].map(|offset| Served::start(&bench("R20C20", offset, 12.0), MOST_PACE).unwrap());
    let (one, two) = (Switch::start(served[0].address()), Switch::start(served[1].address()));
    let farm = farm(vec![at("1", one.address()), at("2", two.address())]);
    Small::new(&farm, folder.path(), FarmStage::Fit).run().unwrap();
    // The cables are swapped.
    one.connect_to(served[1].address());
    two.connect_to(served[0].address());
    let again = |adopt: &[&str]| Small {
        adopt: adopt.iter().map(|name| name.parse().unwrap()).collect(),
        recalibrate: true,
        ..Small::new(&farm, folder.path(), FarmStage::Contact)
    };
    let refused = again(&[]).run().unwrap_err().to_string();
    assert!(
        refused.contains("farm.toml:") && refused.contains("it holds the calibration of unit"),
        "{refused}"
    );
    let everything = Small { until: FarmStage::Flash, ..again(&[]) };
    let ticks = |served: &Served| {
        let mut device = Device::connect(served.address()).unwrap();
        assert_eq!(device.identify().unwrap().mode, Mode::Standby);
        device.settings().unwrap()
    };
    let before = served.each_ref().map(ticks);
    everything.run().unwrap_err();
    assert_eq!(served.each_ref().map(ticks), before, "no device was given settings or started");
    // Both are taken for replaced devices: they are measured again, and known from then on.
    let adopted = Small { until: FarmStage::Fit, recalibrate: false, ..again(&["1", "2"]) }.run().unwrap();
    for (unit, served) in adopted.units.iter().zip(served.iter().rev()) {
        assert_eq!(unit.problem, None);
        let held = Device::connect(served.address()).unwrap().calibration(0).unwrap().1;
        assert_eq!((held, unit.drift), (unit.calibration, None));
    }
    again(&[]).run().unwrap();
}

#[test]
fn a_unit_that_comes_late_is_in_the_controller_of_the_farm() {
    let folder = tempfile::tempdir().unwrap();
    let served = [0.1, 0.4].map(|offset| Served::start(&bench("R20C20", offset, 12.0), MOST_PACE).unwrap());
    let late = Switch::start(served[1].address());
    let farm = farm(vec![at("1", served[0].address()), at("2", late.address())]);
    late.unplug();
    let first = Small::new(&farm, folder.path(), FarmStage::Train).run().unwrap();
    assert!(first.units[1].problem.is_some());
    let controller = || std::fs::read(folder.path().join("controller.safetensors")).unwrap();
    let alone = controller();
    late.connect_to(served[1].address());
    let second = Small::new(&farm, folder.path(), FarmStage::Train).run().unwrap();
    assert_eq!((second.units[1].problem.as_ref(), second.units[1].breaths), (None, BREATHS));
    assert_ne!(controller(), alone);
}

#[test]
fn devices_that_change_their_ports_while_a_farm_runs_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let served = [0.1, 0.4].map(|offset| Served::start(&bench("R20C20", offset, 12.0), MOST_PACE).unwrap());
    let one = Switch::start(served[0].address());
    let farm = farm(vec![at("1", one.address()), at("2", served[1].address())]);
    Small::new(&farm, folder.path(), FarmStage::Fit).run().unwrap();
    let never = AtomicBool::new(false);
    let observer = |event: &Event<'_>| {
        if event.subject == "1" && event.stage == COLLECT && event.done == 3 {
            one.connect_to(served[1].address());
        }
    };
    let again = Small { recalibrate: true, ..Small::new(&farm, folder.path(), FarmStage::Collect) };
    let result = again.watched(&Progress::new(&observer, &never)).unwrap();
    let problem = result.units[0].problem.as_ref().unwrap();
    assert!(
        problem.contains("answers as another unit") || problem.contains("the device refused"),
        "{problem}"
    );
    assert!(result.units[0].breaths <= 4, "no breath of the wrong device: {}", result.units[0].breaths);
}

#[test]
fn a_sensor_that_has_drifted_is_measured_again_and_its_drift_reported() {
    let folder = tempfile::tempdir().unwrap();
    let benches = [bench("R20C20", 0.1, 12.0), bench("R20C20", 0.5, 12.0)];
    let [before, after] = benches.each_ref().map(|bench| Served::start(bench, MOST_PACE).unwrap());
    let switch = Switch::start(before.address());
    let farm = farm(vec![at("1", switch.address())]);
    let first = Small::new(&farm, folder.path(), FarmStage::Fit).run().unwrap();
    assert!(first.units[0].drift.is_none());
    // Months later: a device with the same memory, whose sensor reads more.
    Device::connect(after.address()).unwrap().calibrate(&first.units[0].calibration.unwrap()).unwrap();
    switch.connect_to(after.address());
    let again = Small { recalibrate: true, ..Small::new(&farm, folder.path(), FarmStage::Fit) };
    let result = again.run().unwrap();
    let drift = result.units[0].drift.unwrap();
    let expected = offset_of(&benches[1]) - offset_of(&benches[0]);
    assert_eq!(drift.calibrations, 2);
    assert!((f64::from(drift.sensor_zero) - expected).abs() < 0.05, "{drift:?}, not {expected}");
    let mut device = Device::connect(after.address()).unwrap();
    assert_eq!(device.calibration(0).unwrap(), (2, result.units[0].calibration));
    assert_eq!(device.calibration(1).unwrap().1, first.units[0].calibration, "the device keeps the history");
    assert!(report::drift(&result).is_some_and(|table| table.to_plain().contains("Drift")));
}

#[test]
fn one_simulator_for_all_units_has_the_parameters_of_each() {
    let folder = tempfile::tempdir().unwrap();
    let benches = [bench("R20C20", 0.1, 12.0), bench("R50C20", 0.1, 17.0)];
    let served = benches.each_ref().map(|bench| Served::start(bench, MOST_PACE).unwrap());
    let farm = farm(vec![at("1", served[0].address()), at("2", served[1].address())]);
    let one = Small { simulators: Simulators::One, ..Small::new(&farm, folder.path(), FarmStage::Fit) };
    let result = one.run().unwrap();
    for (unit, bench) in result.units.iter().zip(&benches) {
        let figures = unit.figures.as_ref().unwrap().figures;
        assert!(figures.open_loop < 0.5, "{figures:?}");
        assert!((f64::from(figures.unit.dead_time_ms) - bench.valve.dead_time_ms).abs() < 3.0, "{figures:?}");
    }
    assert!(folder.path().join("simulator.safetensors").exists());
}

#[test]
fn a_folder_of_another_farm_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(&bench("R20C20", 0.1, 12.0), MOST_PACE).unwrap();
    let (one, two) = (farm(vec![at("1", served.address())]), farm(vec![at("2", served.address())]));
    Small::new(&one, folder.path(), FarmStage::Contact).run().unwrap();
    let refused = Small::new(&two, folder.path(), FarmStage::Contact).run().unwrap_err();
    let other = matches!(refused, StudyError::Workspace(WorkspaceError::OtherRun { .. }));
    assert!(other, "{refused}");
}

#[test]
fn a_stopped_farm_continues() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(&bench("R20C20", 0.1, 12.0), MOST_PACE).unwrap();
    let farm = farm(vec![at("1", served.address())]);
    let stop = AtomicBool::new(false);
    let observer = |event: &Event<'_>| stop.store(event.done >= 4, Ordering::Relaxed);
    let half = Small::new(&farm, folder.path(), FarmStage::Collect)
        .watched(&Progress::new(&observer, &stop))
        .unwrap();
    assert!(half.units[0].breaths >= 4 && half.units[0].breaths < BREATHS, "{half:?}");
    Small::new(&farm, folder.path(), FarmStage::Collect).run().unwrap();
    whole_recording(folder.path(), "1");
}
