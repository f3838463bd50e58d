//! The measurements: each part runs many times on changing inputs, as in a breath.

use core::hint::black_box;
use core::panic::PanicInfo;
use core::ptr::addr_of;

use bench::{
    Bench, BenchConfig, BlowerConfig, CompartmentConfig, Distortion, FaultConfig, Faulty, LungConfig,
    MOST_FAULTS, PatientConfig, Signal,
};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use defmt_rtt as _;
use ed25519_compact::{KeyPair, Seed};
use embassy_stm32::pac::TIM5;
use shared::breath::{Breath, DEFAULT_PERIOD_US, PAPER_PIPS, Phase, paper_settings};
use shared::control::features::{FEATURES, FeatureSpec, FeatureState};
use shared::control::network::{INPUTS, Network};
use shared::control::residual::{Residual, ResidualSpec};
use shared::control::{ControlLaw, ControlOutput, Controller, ControllerState, Observation};
use shared::device::control::Control;
use shared::device::prescription::{Prescription, PrescriptionMemory};
use shared::device::{ControlReport, ControlRequest, HostRole, KNOWN_GOOD};
use shared::explore::Exploration;
use shared::link::frame::{FRAME_BYTES, encode_frame};
use shared::link::messages::{ControllerChoice, DeviceKind, Event, ToHost};
use shared::link::telemetry::{Batcher, Counters};
use shared::math;
use shared::recorder::{Boot, Recorder, RecorderMemory};
use shared::reset::ResetCause;
use shared::safety::filter::ValveCommand;
use shared::safety::monitors::Monitors;
use shared::safety::supervisor::{Supervisor, SupervisorState};
use shared::sensor::{Counts, Readings};
use shared::timing::TickTime;
use shared::ventilator::Output;
use shared::weights::trust::{Trust, seal};
use shared::weights::{IMAGE_BYTES, Identity, decode, encode};

use static_cell::StaticCell;

use super::exact_lung::ExactLung;
use super::fixture::{Numbers, RUNS, reference_bits, relu};

/// QEMU's `-icount shift`: an instruction takes 2 to this power nanoseconds.
const INSTRUCTION_SHIFT: u32 = 3;
/// Core clock of the main board, Hz; only the tick statistics need it.
const CORE_HZ: u32 = 168_000_000;
/// Ticks per breath of the closed loop.
const TICKS: u32 = 3000;

/// Mean and worst cost of a part, instructions.
#[derive(Clone, Copy)]
struct Cost {
    runs: u32,
    total: u64,
    worst: u32,
}

impl Cost {
    const NONE: Self = Self { runs: 0, total: 0, worst: 0 };

    /// Measures one run of `work`.
    fn of<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let start = TIM5.cnt().read();
        let result = black_box(work());
        let count = TIM5.cnt().read().wrapping_sub(start) >> INSTRUCTION_SHIFT;
        self.runs += 1;
        self.total += u64::from(count);
        self.worst = self.worst.max(count);
        result
    }

    /// Adds the runs of another measurement.
    fn add(&mut self, other: &Self) {
        self.runs += other.runs;
        self.total += other.total;
        self.worst = self.worst.max(other.worst);
    }

    /// Prints mean and worst cost without the cost of the measurement itself.
    fn print(&self, name: &str, counting: &Self) {
        let mean = self.total / u64::from(self.runs.max(1)) - u64::from(counting.worst);
        hprintln!("{} {} {}", name, mean, self.worst - counting.worst);
    }
}

#[entry]
fn main() -> ! {
    TIM5.psc().write_value(0);
    TIM5.arr().write_value(u32::MAX);
    TIM5.cr1().modify(|w| w.set_cen(true));
    let mut counting = Cost::NONE;
    for _ in 0..RUNS {
        counting.of(|| ());
    }
    networks(&counting);
    parts(&counting);
    monitors(&counting);
    boot(&counting);
    let control = prepare();
    telemetry(&counting, control);
    recording(&counting, control);
    ticks(&counting, control);
    desk(&counting, control);
    debug::exit(debug::EXIT_SUCCESS);
    unreachable!("QEMU has ended")
}

/// Measures the reference network, 40-32-32-1, with relu and with softsign. Also prints the bits of the outputs, which
/// the host compares.
#[inline(never)]
fn networks(counting: &Cost) {
    let (mut with_relu, mut with_softsign) = (Cost::NONE, Cost::NONE);
    let [relu_bits, softsign_bits] = reference_bits(
        |network, inputs| with_relu.of(|| black_box(network).forward_with(black_box(inputs), relu)),
        |network, inputs| with_softsign.of(|| black_box(network).forward(black_box(inputs))),
    );
    with_relu.print("network_40_32_32_1_relu", counting);
    with_softsign.print("network_40_32_32_1_softsign", counting);
    hprintln!("bits {} {}", relu_bits, softsign_bits);
}

fn residual() -> Residual {
    let mut network = Network::zero();
    Numbers(2).fill(network.parameters_mut());
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: KNOWN_GOOD,
        lambda: 0.5,
        authority: 30.0,
        features: FeatureSpec::default(),
    };
    built(Residual::new(spec, network))
}

fn breath(pip: f32) -> Breath {
    built(Breath::new(&paper_settings(pip), DEFAULT_PERIOD_US))
}

/// Unwraps a value that is built from constants.
fn built<T, E>(result: Result<T, E>) -> T {
    match result {
        Ok(value) => value,
        Err(_) => unreachable!("all constants are in bounds"),
    }
}

/// Measures the parts of a tick one by one.
#[inline(never)]
fn parts(counting: &Cost) {
    let residual = residual();
    let controller = Controller::Residual(residual.clone());
    let pid = Controller::Pid(*residual.pid());
    let breath = breath(20.0);
    let (mut state, mut pid_state) = (ControllerState::new(), ControllerState::new());
    let mut feature_state = FeatureState::new();
    let mut costs = [Cost::NONE; 6];
    let [sensor, features, network, learned, plain, explore] = &mut costs;
    let mut numbers = Numbers(3);
    for run in 0..RUNS {
        let counts = Counts { airway: 2500 + run as u16, outlet: 2510, flow: 2100 };
        black_box(sensor.of(|| Readings::from(black_box(counts))));
        let pressure = 15.0 + 5.0 * numbers.next();
        let seen = Observation { pressure, target: 20.0, pip: 20.0, peep: 5.0, tick: run, rise_ticks: 0 };
        let seen_features =
            features.of(|| residual.features().step(&mut feature_state, black_box(&seen), 30.0));
        let mut input = [0.0; INPUTS];
        input[..FEATURES].copy_from_slice(&seen_features);
        network.of(|| residual.network().forward(black_box(&input)));
        learned.of(|| {
            let command = controller.step(&mut state, black_box(&seen)).command;
            controller.applied(&mut state, command);
        });
        plain.of(|| pid.step(&mut pid_state, black_box(&seen)));
        explore.of(|| Exploration::default().perturbation(&breath, black_box(run)));
    }
    for (name, cost) in
        ["sensor", "features", "network", "residual_controller", "pid", "exploration"].iter().zip(&costs)
    {
        cost.print(name, counting);
    }
    let mut softsign = Cost::NONE;
    softsign.of(|| math::softsign(black_box(0.3)));
    softsign.print("softsign", counting);
}

/// The readings of all sensors at a plant that had this pressure a tick ago, cmH2O.
fn sensed(plant: &ExactLung, before: f32) -> Readings {
    /// The change of 1 cmH2O in a tick of 1 ms, as a flow into 20 mL/cmH2O, L/s.
    const FLOW: f32 = 20.0;
    let airway = plant.pressure();
    Readings { airway, outlet: airway + 0.1, flow: FLOW * (airway - before) }
}

/// Measures all monitors, ladder and filter over whole breaths of a learned controller, so that the checks at the end of a
/// phase are included.
#[inline(never)]
fn monitors(counting: &Cost) {
    let breath = breath(25.0);
    let supervisor = Supervisor::new(DEFAULT_PERIOD_US, Monitors::ALL);
    let (mut state, mut cost) = (SupervisorState::default(), Cost::NONE);
    let mut plant = ExactLung::new(breath.settings().peep);
    let mut before = plant.pressure();
    for tick in (0..3).flat_map(|_| 0..breath.total_ticks()) {
        let inspires = breath.phase(tick) == Phase::Inspiration;
        let (readings, asked) = (sensed(&plant, before), breath.target(tick) - plant.pressure());
        before = plant.pressure();
        let base = if inspires { math::limit(20.0 + 5.0 * asked, 0.0, 90.0) } else { 0.0 };
        let wanted = ControlOutput { base, command: base + 1.0 };
        let command = cost.of(|| {
            let belief = supervisor.check(&mut state, black_box(&readings), breath.at(tick))?;
            Some(supervisor.command(&mut state, &belief, black_box(wanted), !inspires))
        });
        let Some(command) = command else { unreachable!("the plant of the golden traces raises no alarm") };
        plant.step(command.u_in(), command.u_out());
    }
    cost.print("monitors", counting);
}

/// Measures packing a sample, and encoding a full batch, which is the work of the link task and not of the tick.
#[inline(never)]
fn telemetry(counting: &Cost, control: &mut Control) {
    let (mut pack, mut encoding) = (Cost::NONE, Cost::NONE);
    let mut batcher = Batcher::default();
    renew(control);
    begin(control);
    for tick in 0..u64::from(RUNS) {
        let readings = Readings { flow: 0.5, ..Readings::from(5.0) };
        let Some(sample) = control.step(readings).sample else { continue };
        let batch = pack.of(|| batcher.push(tick, black_box(&sample), &Counters::default()));
        if let Some(batch) = batch {
            let event = ToHost::Event(Event::Telemetry(batch));
            let mut buffer = [0; FRAME_BYTES];
            let _ = encoding.of(|| encode_frame(black_box(&event), &mut buffer).map(<[u8]>::len));
        }
    }
    pack.print("telemetry_sample", counting);
    encoding.print("telemetry_frame", counting);
}

/// Measures the validation of the weights at the start of the program.
#[inline(never)]
fn boot(counting: &Cost) {
    let mut image = [0; IMAGE_BYTES];
    built(encode(&residual(), &Identity::default(), &mut image));
    let mut cost = Cost::NONE;
    built(cost.of(|| decode(black_box(&image)).map(drop)));
    cost.print("boot_decode_weights", counting);
    let pair = KeyPair::from_seed(Seed::new([1; 32]));
    seal(&mut image, 1, |bytes| *pair.sk.sign(bytes, None));
    let (trust, mut cost) = (Trust::Key { key: *pair.pk, plant: None }, Cost::NONE);
    built(cost.of(|| trust.verify(black_box(&image))));
    cost.print("boot_verify_weights", counting);
}

/// The device's control half, static because it takes a third of the stack.
static CONTROL: StaticCell<Control> = StaticCell::new();

/// Builds the control half. Called once.
#[inline(never)]
fn prepare() -> &'static mut Control {
    CONTROL.init_with(blank)
}

fn blank() -> Control {
    built(Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ))
}

/// Begins again with a learned controller.
fn renew(control: &mut Control) {
    clear(control);
    learn(control);
}

#[inline(never)]
fn clear(control: &mut Control) {
    *control = blank();
}

#[inline(never)]
fn learn(control: &mut Control) {
    control.learn(&residual());
}

/// Starts ventilation.
fn begin(control: &mut Control) {
    control.execute(&ControlRequest::Apply(paper_settings(PAPER_PIPS[0])));
    control.execute(&ControlRequest::Start);
}

unsafe extern "C" {
    /// Beginning of the region of the flight recorder.
    static __recorder_start: u8;
}

/// The flight recorder's memory, where the firmware has it.
fn memory() -> &'static RecorderMemory {
    // SAFETY: the region is large and aligned enough, as the firmware asserts, contains nothing else, and any content is valid.
    unsafe { &*addr_of!(__recorder_start).cast() }
}

fn recorder() -> Recorder<'static> {
    Recorder::attach(
        memory(),
        Boot { cause: ResetCause::PowerOn, failed: false, weights: None, restored: false },
    )
}

/// Measures the flight recorder's part of a tick.
#[inline(never)]
fn recording(counting: &Cost, control: &mut Control) {
    let (mut recorder, mut cost) = (recorder(), Cost::NONE);
    renew(control);
    begin(control);
    for tick in 0..2 * TICKS {
        let reading = 5.0 + (tick % 1000) as f32 / 100.0;
        let output = control.step(reading);
        let moment = control.moment(reading, &output, 0);
        cost.of(|| recorder.record(black_box(&moment)));
    }
    cost.print("flight_recorder", counting);
}

/// The prescription's memory.
static PRESCRIPTION: PrescriptionMemory = PrescriptionMemory::new();

/// Measures whole ticks of the device's control half, learned and exploring, on the plant of the golden traces with all sensors:
/// step, report, request, prescription and flight recorder, as in the control task. Ticks of the inspiration, in which the network runs, are also counted
/// separately.
#[inline(never)]
fn ticks(counting: &Cost, control: &mut Control) {
    renew(control);
    let (mut recorder, mut prescription) = (recorder(), Prescription::attach(&PRESCRIPTION, None, None));
    let mut plant = ExactLung::new(paper_settings(PAPER_PIPS[0]).peep);
    let mut before = plant.pressure();
    begin(control);
    let (mut all, mut inspiring) = (Cost::NONE, Cost::NONE);
    for pip in PAPER_PIPS {
        let settings = paper_settings(pip);
        plant.set_peep(settings.peep);
        let mut requests = [
            ControlRequest::Apply(settings),
            ControlRequest::Exploration(Some(Exploration::default())),
            ControlRequest::Controller(ControllerChoice::Learned),
            ControlRequest::Timing { clear: false },
        ]
        .into_iter();
        for _ in 0..TICKS {
            let (mut cost, request, readings) = (Cost::NONE, requests.next(), sensed(&plant, before));
            before = plant.pressure();
            let keepers = (&mut recorder, &mut prescription);
            let output = cost.of(|| tick(control, keepers, black_box(readings), black_box(request)));
            let Some(sample) = output.sample else { unreachable!("the ventilator ventilates to the end") };
            if sample.phase == Phase::Inspiration {
                inspiring.add(&cost);
            }
            all.add(&cost);
            plant.step(output.command.u_in(), output.command.u_out());
        }
    }
    all.print("tick", counting);
    inspiring.print("tick_of_inspiration", counting);
}

/// Measures the bench that a board on the desk simulates: a start, a step with all readings, and a step with the tick that controls it,
/// on the default bench and on busy ones.
#[inline(never)]
fn desk(counting: &Cost, control: &mut Control) {
    let (mut starting, mut stepping, mut whole) = (Cost::NONE, Cost::NONE, Cost::NONE);
    // The distortions that take longest.
    let distortions =
        [Distortion::Noise(0.1), Distortion::Hum { amplitude: 0.1, hz: 50.0 }, Distortion::LagMs(20.0)];
    for config in core::iter::once(BenchConfig::default()).chain(distortions.into_iter().map(busy)) {
        start(&config, &mut starting);
        renew(control);
        let cost = breathe(&config, counting, control);
        stepping.add(&cost[0]);
        whole.add(&cost[1]);
    }
    starting.print("bench_start", counting);
    stepping.print("bench_step", counting);
    whole.print("tick_on_the_desk", counting);
}

/// A bench in which every part is at work, with as many faults as a chip takes.
fn busy(distortion: Distortion) -> BenchConfig {
    let what = Faulty::Sensor { signal: Signal::Converter, distortion };
    let fault = FaultConfig { from_s: 0.0, to_s: None, repeats: None, what };
    BenchConfig {
        blower: Some(BlowerConfig::default()),
        lung: LungConfig { second: Some(CompartmentConfig::default()), ..LungConfig::default() },
        patient: PatientConfig {
            effort_cmh2o: 8.0,
            effort_variability_percent: 20.0,
            effort_wanes_percent: 50.0,
            cough_cmh2o: 30.0,
            coughs_per_hour: 600.0,
            resistance_growth_percent_per_hour: 10.0,
            ..PatientConfig::default()
        },
        faults: core::iter::repeat_n(fault, MOST_FAULTS).collect(),
        ..BenchConfig::default()
    }
}

/// Starts a bench; a separate function, because a bench fills much of the stack.
#[inline(never)]
fn start(config: &BenchConfig, cost: &mut Cost) {
    black_box(cost.of(|| Bench::new(black_box(config), 5.0, 1).is_ok()));
}

/// Ventilates a bench for two breaths; the cost of its steps, and of its steps with the ticks.
#[inline(never)]
fn breathe(config: &BenchConfig, counting: &Cost, control: &mut Control) -> [Cost; 2] {
    let (mut stepping, mut whole) = (Cost::NONE, Cost::NONE);
    let settings = paper_settings(PAPER_PIPS[5]);
    let mut bench = built(Bench::new(config, settings.peep, 1));
    let mut command = ValveCommand::SAFE;
    let (mut recorder, mut prescription) = (recorder(), Prescription::attach(&PRESCRIPTION, None, None));
    control.execute(&ControlRequest::Apply(settings));
    control.execute(&ControlRequest::Start);
    for _ in 0..2 * TICKS {
        let (mut step, mut controlled) = (Cost::NONE, Cost::NONE);
        let readings = step.of(|| {
            let airway = bench.step(command.u_in(), command.u_out());
            Readings { airway, outlet: bench.outlet_reading(), flow: bench.flow_reading() }
        });
        let keepers = (&mut recorder, &mut prescription);
        let output = controlled.of(|| tick(control, keepers, black_box(readings), None));
        command = output.command;
        stepping.add(&step);
        step.worst += controlled.worst - counting.worst;
        step.total += controlled.total - u64::from(counting.worst);
        whole.add(&step);
    }
    [stepping, whole]
}

fn tick(
    control: &mut Control,
    (recorder, prescription): (&mut Recorder, &mut Prescription),
    readings: Readings,
    request: Option<ControlRequest>,
) -> Output {
    let output = control.step(readings);
    control.report(&output, &mut |report: ControlReport| {
        black_box(report);
        true
    });
    prescription.keep(control, &output);
    if let Some(request) = request {
        black_box(prescription.execute(control, &request, HostRole::Steers));
    }
    recorder.record(&control.moment(readings.airway, &output, black_box(0)));
    control.record(black_box(&TickTime { latency: 20, work: 5000, period: Some(168_000), missed: 0 }));
    output
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    hprintln!("{}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}
