//! Control on the image: readings, golden traces, recordings, repeatability.

use super::*;

/// Clock cycles per instruction in QEMU: 8 ns of virtual time at 168 MHz.
const CYCLES_PER_INSTRUCTION: f32 = 1.344;

fn pid(gains: PidGains) -> Controller {
    Controller::Pid(Pid::new(gains, 1000).unwrap())
}

/// The lung of the golden traces as a plant on the plant line.
struct GoldenPlant(ExactLung);

impl GoldenPlant {
    fn reading(&self) -> Reading {
        Reading::of_pressure(self.0.pressure())
    }
}

impl Plant for GoldenPlant {
    type Error = Infallible;

    fn name(&self) -> String {
        "exact lung".to_owned()
    }

    fn reset(&mut self, _period_us: u32, _seed: u64, peep: f32) -> Result<Reading, Infallible> {
        self.0 = ExactLung::new(peep);
        Ok(self.reading())
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), Infallible> {
        self.0.set_peep(peep);
        Ok(())
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, Infallible> {
        self.0.step(u_in, u_out);
        Ok(self.reading())
    }
}

#[test]
fn the_boards_own_image_stands_by_names_the_missing_sensor_and_does_not_start() {
    let board = Emulator::start(config("board"), Silence).unwrap();
    let mut device = connect(&board);
    let identity = device.identify().unwrap();
    assert_eq!((identity.device, identity.reset), (DeviceKind::Ventilator, ResetCause::PowerOn));
    assert_eq!(identity.mode, Mode::Standby);
    assert!(device.alarms().unwrap().indicated.has(Fault::ReadingNotANumber));
    assert_eq!((identity.slots, identity.running), ([SlotState::Empty; 2], None));
    assert_eq!(identity.controller, ControllerChoice::Pid(KNOWN_GOOD), "no weights: the PID");
    assert!(start(&mut device).unwrap_err().to_string().contains("no pressure sensor is sound"));
    assert!(device.reset_plant(1).is_err(), "a ventilator has no plant");
}

/// Verifies: same-bits.
#[test]
fn golden_trace_of_learned_weights_is_the_hosts_bit_for_bit() {
    let host = trace::run(trace::learned()).unwrap();
    let board = Emulator::start(config("hil"), LockstepPlant::new(GoldenPlant(ExactLung::new(5.0)))).unwrap();
    let mut port = PortSource::new(connect(&board), 0).unwrap();
    port.know(trace::LEARNED.to_vec());
    port.configure(trace::learned(), Some(trace::exploration())).unwrap();
    let plan: Vec<Settings> = (0..trace::BREATHS).map(trace::settings).collect();
    port.upcoming(&plan).unwrap();
    let (mut hash, mut entries) = (Fnv::default(), Vec::new());
    for (number, settings) in (1..).zip(&plan) {
        port.breath(settings, &mut |tick| hash.command(tick.sample.u_in, tick.sample.u_out)).unwrap();
        if number % trace::ENTRY_BREATHS == 0 {
            entries.push((number, hash.value()));
        }
    }
    drop(port);
    let expected: Vec<(u32, u64)> = host.entries.iter().map(|entry| (entry.breaths, entry.hash)).collect();
    let times = connect(&board).timing(false).unwrap();
    let instructions = |cycles: f32| (cycles / CYCLES_PER_INSTRUCTION) as u32;
    let hash = |entries: &[(u32, u64)]| format!("{:016x}", entries.last().unwrap().1);
    let found = BTreeMap::from([
        ("hash_host", serde_json::json!(hash(&expected))),
        ("hash_qemu", serde_json::json!(hash(&entries))),
        ("tick_mean", serde_json::json!(instructions(times.work.mean))),
        ("tick_worst", serde_json::json!(instructions(times.work.longest as f32))),
    ]);
    fs::write(image("golden").with_extension("json"), serde_json::to_string_pretty(&found).unwrap()).unwrap();
    assert_eq!(entries, expected);
}

#[test]
fn it_ventilates_all_lungs_of_the_paper() {
    // No PID suits all lungs; the resistance determines the gains.
    let gains = |p, i| PidGains { p, i, d: 0.0 };
    let tuned = [(5.0, gains(20.0, 100.0)), (20.0, gains(5.0, 100.0)), (50.0, gains(3.5, 25.0))];
    for ((resistance, gains), compliance) in
        tuned.into_iter().flat_map(|tuned| [10.0, 20.0, 50.0].map(|compliance| (tuned, compliance)))
    {
        let (_board, device) = breathing(config("hil"), &BenchConfig::paper(resistance, compliance));
        let mut port = PortSource::new(device, 1).unwrap();
        port.configure(pid(gains), None).unwrap();
        let breaths = [paper_settings(15.0), paper_settings(15.0)];
        port.upcoming(&breaths).unwrap();
        let mut plateau = Vec::new();
        for breath in &breaths {
            plateau.clear();
            port.breath(breath, &mut |tick| {
                if tick.sample.phase == Phase::Inspiration && tick.sample.tick >= 900 {
                    plateau.push(tick.sample.pressure);
                }
            })
            .unwrap();
        }
        let mean = plateau.iter().sum::<f32>() / plateau.len() as f32;
        assert!((mean - 15.0).abs() < 1.0, "R{resistance}C{compliance}: a plateau of {mean} cmH2O");
    }
}

#[test]
fn a_recording_over_the_link_is_that_of_the_bench_in_process_bit_for_bit() {
    let (_board, device) = breathing(config("hil"), &lung());
    let config = CollectConfig { breaths: 30, seed: (1 << 51) + 3, ..CollectConfig::default() };
    let controller = pid(KNOWN_GOOD);
    let mut bench =
        BenchSource::new(&lung(), controller.clone(), &config.settings, 1000, config.seed).unwrap();
    let here = collect(&mut bench, &controller, &config, &Progress::silent()).unwrap().recording;
    let mut port = PortSource::new(device, config.seed).unwrap();
    let there = collect(&mut port, &controller, &config, &Progress::silent()).unwrap().recording;
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&here.u_in), bits(&there.u_in));
    assert_eq!(bits(&here.pressure), bits(&there.pressure));
    assert_eq!(bits(&here.target), bits(&there.target));
    assert_eq!(bits(&here.explore), bits(&there.explore));
    assert_eq!((&here.breath, &here.tick, &here.phase), (&there.breath, &there.tick, &there.phase));
    assert_eq!(&here.u_out, &there.u_out);
}

#[test]
fn two_runs_on_the_image_are_equal() {
    let run = || {
        let (_board, device) = breathing(config("hil"), &lung());
        let mut port = PortSource::new(device, 9).unwrap();
        port.configure(pid(KNOWN_GOOD), None).unwrap();
        let breaths = PAPER_PIPS.map(paper_settings);
        port.upcoming(&breaths).unwrap();
        let mut hash = Fnv::default();
        for breath in &breaths {
            port.breath(breath, &mut |tick| hash.command(tick.sample.u_in, tick.sample.u_out)).unwrap();
        }
        hash.value()
    };
    assert_eq!(run(), run());
}
