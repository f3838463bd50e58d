//! The link: settings, telemetry under load, hosts and plants that vanish.

use super::*;

use shared::link::host_name::HostName;
use shared::link::messages::Request;

/// Length of a control tick, cycles.
const TICK_CYCLES: u32 = 168_000;

/// Cycles per microsecond.
const MICROSECOND: u32 = 168;

/// Verifies: settings-bounds.
#[test]
fn settings_take_effect_at_the_breath_boundary_and_are_refused_with_the_reason() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    device.apply(paper_settings(15.0)).unwrap();
    device.start().unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| sample.tick >= 100);
    device.apply(paper_settings(30.0)).unwrap();
    let refused = device.apply(Settings { pip: 70.0, ..Settings::default() }).unwrap_err();
    assert!(refused.to_string().contains("pip is 70 cmH2O, allowed are 5 to 60"), "{refused}");
    samples.until(&device, |sample| sample.breath == 3);
    let inspiration = samples.all.iter().filter(|sample| sample.phase == Phase::Inspiration);
    let mut targets: BTreeMap<u32, Vec<f32>> = BTreeMap::new();
    inspiration.for_each(|sample| targets.entry(sample.breath).or_default().push(sample.target));
    assert!(
        targets.values().all(|targets| targets.iter().all(|target| target.to_bits() == targets[0].to_bits()))
    );
    let pips: Vec<f32> = targets.values().map(|targets| targets[0]).collect();
    assert_eq!((pips[0], pips.last()), (15.0, Some(&30.0)));
}

/// Another host takes the lease over.
fn taken_over(device: &mut Device) {
    let name = HostName::new("anna@icu");
    device.send_as(0, &Request::AcquireLease { name, take_over: true }).unwrap();
}

#[test]
fn another_host_is_refused_with_the_holders_name_and_ventilation_goes_on() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    assert!(device.start().unwrap_err().to_string().contains("no settings were sent"));
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    let refused = loop {
        // On a virtual board the lease may lapse within a moment.
        taken_over(&mut device);
        if let Err(refused) = device.apply(paper_settings(10.0)) {
            break refused.to_string();
        }
    };
    assert!(refused.contains("anna@icu steers this device"), "{refused}");
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    assert!(device.acquire_lease(true).unwrap().yours);
    assert_eq!(device.stop().unwrap(), Mode::Standby);
    assert!(device.start().unwrap_err().to_string().contains("no settings were sent"));
}

/// Verifies: host-independence.
#[test]
fn sixty_seconds_of_telemetry_under_a_flooding_host_miss_no_tick_and_no_sample() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
    device.timing(true).unwrap();
    let mut samples = Samples::default();
    for breath in 0..20 {
        // Continuous requests, bytes outside frames and a truncated frame, throughout the breath.
        for _ in 0..10 {
            device.settings().unwrap();
            device.send_raw(&[0x55; 300]).unwrap();
            device.send_raw(&[0, 7, 1, 2, 0]).unwrap();
        }
        samples.until(&device, |sample| sample.breath > breath);
    }
    let times = device.timing(false).unwrap();
    assert!(samples.all.len() >= 60_000, "{} samples", samples.all.len());
    assert_eq!(
        (samples.counters.dropped, device.counters().lost_batches, device.counters().corrupt),
        (0, 0, 0)
    );
    assert!(samples.counters.corrupt_frames >= 200, "the garbage is counted: {:?}", samples.counters);
    assert_eq!((times.missed, samples.counters.missed_ticks), (0, 0));
    let (shortest, longest) = (times.period.shortest, times.period.longest);
    let allowed = TICK_CYCLES - 2 * MICROSECOND..=TICK_CYCLES + 2 * MICROSECOND;
    assert!(
        allowed.contains(&shortest) && allowed.contains(&longest),
        "periods of {shortest} to {longest} cycles: {times:?}"
    );
}

/// Number of exchanges with a plant, one per control tick.
#[derive(Default)]
struct Ticks {
    count: Mutex<u64>,
    more: Condvar,
}

impl Ticks {
    /// Waits for `ticks` more exchanges.
    fn wait_for(&self, ticks: u64) {
        let count = self.count.lock().unwrap();
        let end = *count + ticks;
        let (count, _) = self.more.wait_timeout_while(count, DEADLINE, |count| *count < end).unwrap();
        assert!(*count >= end, "the board has stopped");
    }
}

/// A plant whose exchanges are counted.
struct Counted<P>(P, Arc<Ticks>);

impl<P: PlantEnd> PlantEnd for Counted<P> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        *self.1.count.lock().unwrap() += 1;
        self.1.more.notify_all();
        self.0.answer(request)
    }
}

/// Verifies: host-independence.
#[test]
fn a_host_that_falls_silent_and_comes_back_finds_the_device_ventilating() {
    let ticks = Arc::new(Ticks::default());
    let bench = LockstepPlant::new(BenchPlant::new(&lung()).unwrap());
    let board = Emulator::start(config("hil"), Counted(bench, Arc::clone(&ticks))).unwrap();
    let mut device = connect(&board);
    device.apply(paper_settings(25.0)).unwrap();
    device.start().unwrap();
    drop(device);
    ticks.wait_for(300);
    // Another program, which sends no frames.
    let mut stranger = TcpStream::connect(board.address()).unwrap();
    stranger.write_all(&[0xFF; 5000]).unwrap();
    ticks.wait_for(300);
    drop(stranger);
    ticks.wait_for(300);
    let mut device = connect(&board);
    let identity = device.identify().unwrap();
    assert_eq!((identity.mode, identity.reset), (Mode::Ventilating, ResetCause::PowerOn));
    assert_eq!(device.settings().unwrap().0, paper_settings(25.0));
    assert_eq!(device.timing(false).unwrap().missed, 0);
}

/// A plant that can be disconnected.
struct Unplugged<P>(P, Arc<AtomicBool>);

impl<P: PlantEnd> PlantEnd for Unplugged<P> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        if self.1.load(Ordering::Relaxed) { Vec::new() } else { self.0.answer(request) }
    }
}

#[test]
fn a_plant_that_vanishes_is_ventilated_in_backup_until_it_returns() {
    let gone = Arc::new(AtomicBool::new(false));
    let bench = LockstepPlant::new(BenchPlant::new(&lung()).unwrap());
    let board = Emulator::start(config("hil"), Unplugged(bench, Arc::clone(&gone))).unwrap();
    let mut device = connect(&board);
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
    Samples::default().until(&device, |sample| sample.breath == 1);
    gone.store(true, Ordering::Relaxed);
    alarmed(&device, Fault::ReadingNotANumber);
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    let alarms = device.alarms().unwrap();
    assert_eq!(alarms.level, Level::Backup);
    assert!(alarms.present.has(Fault::ReadingNotANumber) && alarms.present.has(Fault::BackupVentilation));
    gone.store(false, Ordering::Relaxed);
    indicates(&mut device, |alarms| alarms.level != Level::Backup);
    assert!(device.alarms().unwrap().indicated.has(Fault::BackupVentilation), "until it is acknowledged");
    assert_eq!(device.acknowledge().unwrap(), Mode::Ventilating);
    indicates(&mut device, |alarms| !alarms.indicated.has(Fault::BackupVentilation));
}

#[test]
fn reading_the_recorder_disturbs_no_tick() {
    let (_board, mut device) = breathing(config("hil"), &lung());
    device.telemetry(true).unwrap();
    start(&mut device).unwrap();
    let mut samples = Samples::default();
    samples.until(&device, |sample| sample.breath == 1);
    device.timing(true).unwrap();
    let blackbox = device.blackbox(&Progress::silent()).unwrap();
    samples.until(&device, |sample| sample.breath == 3);
    let times = device.timing(false).unwrap();
    assert_eq!((blackbox.status.recording, blackbox.unread), (RecordingState::Running, 0));
    assert!(blackbox.fast.ticks().all(|tick| tick.activity == Activity::Ventilating));
    assert_eq!((times.missed, samples.counters.missed_ticks, samples.counters.dropped), (0, 0, 0));
    let jitter = times.period.longest.abs_diff(TICK_CYCLES).max(times.period.shortest.abs_diff(TICK_CYCLES));
    assert!(jitter <= 2 * MICROSECOND, "{jitter} cycles");
}
