//! The sentences of the documents that state numbers, each beside the constant that acts.

use super::SAFETY;
use super::figures::{grouped, ms, number, percent, tenths, whole};
use super::sentence::{Claim, quoted};
use plant::bench::BenchConfig;
use shared::calibration::Quantity;
use shared::control::COMMAND_MAX;
use shared::device::REPEAT_TIME;
use shared::device::absence::LONGEST_ABSENCE_S;
use shared::device::prescription::RESUMES;
use shared::flash::journal::RECORD_BYTES;
use shared::link::refusal::AUDIO_PAUSE_MAX;
use shared::recorder::keeper::Keeper;
use shared::safety::ladder::{CAP, CLEAN_BREATHS, DOUBLINGS, HALVINGS};
use shared::safety::plateau::{DOUBTFUL, TUBE};
use shared::safety::slew::RESIDUAL_SLEW;
use shared::safety::{backup, expected, expiration, flow_monitor, lung_estimator, pressure_monitor};
use shared::safety::{reference_volume, settling};
use shared::settings::{LIMIT_MARGIN, Settings};
use shared::timing::{LEASE_S, WATCHDOG_MAX_US, WATCHDOG_US};
use shared::trigger;
use shared::weights::slots::SLOT_BYTES;
use trials::faults::cases::{HAZARDS, LIMIT, LIMITS, PIP, RELIEF};
use trials::faults::matrix::{BACK_WITHIN_MS, VENT_WITHIN_MS};
use trials::faults::{torture, trial};

const HARDWARE: &str = "docs/HARDWARE.md";
const PORTING: &str = "docs/PORTING.md";
const FROZEN_TESTS: &str = "lab/trials/src/faults/frozen_tests.rs";
const RESET_TESTS: &str = "tests/tests/qemu/recovery.rs";
const SUPPLY: &str = "firmware/src/chip/drivers/supply.rs";

/// All of them, by document.
pub fn claims() -> Vec<(&'static str, Claim)> {
    let safety =
        [words(), control(), resets(), sensors(), alarms(), matrix(), delays(), bounds(), not_covered()];
    let hardware = [circuit_check(), relief_check(), chip()];
    let of = |document| move |claim| (document, claim);
    let safety = safety.into_iter().flatten().map(of(SAFETY));
    let hardware = hardware.into_iter().flatten().map(of(HARDWARE));
    safety.chain(hardware).chain(flash().into_iter().map(of(PORTING))).collect()
}

/// A sentence with these numbers in place of `{}`.
fn says<const N: usize>(sentence: &'static str, figures: [String; N]) -> Claim {
    Claim { sentence, figures: figures.into() }
}

fn minutes(seconds: u32) -> String {
    number(f64::from(seconds) / 60.0)
}

/// Numbers that no constant changes.
fn words() -> Vec<Claim> {
    let sentences = [
        "There are two duties",
        "two programs that change settings in turn",
        "checksum, two copies, validation",
    ];
    sentences.map(|sentence| says(sentence, [])).into()
}

/// From controller to valves.
fn control() -> Vec<Claim> {
    vec![
        says("changes by at most {} % per ms", [number(RESIDUAL_SLEW / 1000.0)]),
        says("compiled-in PID, capped at {} %", [number(CAP)]),
        says("finite, 0 to {} %;", [number(COMMAND_MAX)]),
        says("after {} ms at most, the command is the PID's", [ms(COMMAND_MAX / RESIDUAL_SLEW)]),
        says("and {} clean breaths in a row lead one step up", [number(CLEAN_BREATHS)]),
        says("their number doubles, up to {}.", [number(CLEAN_BREATHS << DOUBLINGS)]),
        says("down to {} %.", [number(CAP / (1_u32 << HALVINGS) as f32)]),
    ]
}

/// Watchdog, resets and power cuts.
fn resets() -> Vec<Claim> {
    // The oscillator of the watchdog, kHz: nominal, slowest and fastest (data sheet).
    let [nominal, slowest, fastest] = [32.0, 17.0, 47.0];
    let timeout = f64::from(WATCHDOG_US) / 1000.0;
    let resumed = quoted(RESET_TESTS, "resumed_after(&mut device) <= {}, \"later than 2 s\"");
    let detector = quoted(SUPPLY, "Threshold of the detector, its highest: {} V");
    let brown_out = quoted(SUPPLY, "Code of the brown-out level 3: reset below {} V");
    let longest = || minutes(LONGEST_ABSENCE_S);
    vec![
        says("nominal timeout is {} ms", [number(timeout)]),
        says(
            "the real timeout is between {} and {} ms",
            [whole(timeout * nominal / fastest), whole(timeout * nominal / slowest)],
        ),
        says("the fault matrix assumes {} ms", [number(f64::from(WATCHDOG_MAX_US) / 1000.0)]),
        says("within {} s of the reset", [number(resumed / 1000.0)]),
        says("the interruption lasted at most {} minutes", [longest()]),
        says("still below {} V counts too", [number(detector)]),
        says("after {} resumed starts that failed", [number(RESUMES)]),
        says("standby after {}, where a host can reach it", [number(RESUMES)]),
        says("when the supply returns within {} minutes", [longest()]),
        says("after more than {} minutes", [longest()]),
        says("voltage detector at {} V, brown-out reset at {} V", [number(detector), number(brown_out)]),
        says("if it stays low for {} minutes", [longest()]),
        says("switched on again within {} minutes", [longest()]),
        says("again and again within {} minutes", [longest()]),
    ]
}

/// Pressure sensors, backup ventilation, expirations and volumes.
fn sensors() -> Vec<Claim> {
    let (least, most) = backup::PLAUSIBLE;
    let changed = quoted(FROZEN_TESTS, "Sensors::AirwayOfTwo | Sensors::OutletOfTwo => {},");
    vec![
        says(
            "frozen sensor is detected within {} ms once the pressure should have changed by {} cmH2O",
            [number(quoted(FROZEN_TESTS, "const WITHIN_MS: u32 = {};")), number(changed)],
        ),
        says(
            "if it measures {} to {} % of what the valve's model delivers, give or take {} mL",
            [percent(least), percent(most), number(backup::IN_CIRCUIT)],
        ),
        says("a stiff adult lung ({} mL/cmH2O)", [number(1000.0 * backup::STIFFEST)]),
        says("predicts a pressure within {} cmH2O of the limit", [number(LIMIT_MARGIN)]),
        says("never as less than {} % of what the model delivers", [percent(lung_estimator::LEAST_MEASURED)]),
        says(
            "has a gain below {} or above {} % of the usual one",
            [percent(flow_monitor::GAIN.0), percent(flow_monitor::GAIN.1)],
        ),
        says(
            "An offset of less than {} L/s and {} % of the inspired volume counts as a leak",
            [number(flow_monitor::OFFSET), percent(flow_monitor::INEXACT)],
        ),
        says("little gas ({} mL of the valve's model", [number(flow_monitor::TELLING)]),
        says("holds it up (a command of at most {} %)", [number(expiration::BOUND)]),
        says("in advance, with a command of at most {} %", [number(expiration::LEAK_BOUND)]),
        says("the last {} s do not count", [number(reference_volume::SPAN)]),
        says("an inspiratory time that changes by more than {} %", [percent(settling::NEW_BREATH)]),
        says("before the settings have rested for {} breaths", [number(settling::RESTED_BREATHS)]),
    ]
}

/// Alarms and the lease.
fn alarms() -> Vec<Claim> {
    vec![
        says("when it begins, and every {} s until it is acknowledged", [number(REPEAT_TIME)]),
        says("monitors of the baseline wait for {} breaths", [number(settling::UNCHECKED_BREATHS)]),
        says("lease lapses {} s after the last request", [number(LEASE_S)]),
    ]
}

/// What a row of the fault matrix requires.
fn matrix() -> Vec<Claim> {
    let lungs = BenchConfig::paper_lungs().len();
    let obeying = HAZARDS.iter().flat_map(|(_, cases)| *cases).map(|case| case.peak_allowed(LIMIT));
    let above_limit = obeying.fold(f64::INFINITY, f64::min) - f64::from(LIMIT);
    vec![
        says("every fault on the {} lungs of the paper", [lungs.to_string()]),
        says("with a PIP of {} cmH2O and a pressure limit of {} cmH2O", [number(PIP), number(LIMIT)]),
        says("sets another one, from {} to {}.", [number(LIMITS.0), number(LIMITS.1)]),
        says("vent comes within {} ms of a reading above", [number(VENT_WITHIN_MS)]),
        says(
            "within the last column: {} cmH2O above the limit where the valves obey, and never more than the {} cmH2O",
            [number(above_limit), number(RELIEF)],
        ),
        says(
            "the pressure falls to within {} cmH2O of PEEP in the {} s after",
            [number(trial::BACK), number(f64::from(BACK_WITHIN_MS) / 1000.0)],
        ),
    ]
}

/// How far the pressure rises after it has crossed the limit.
fn delays() -> Vec<Claim> {
    let bench = BenchConfig::default();
    let (valve, circuit) = (&bench.valve, bench.circuit.compliance_ml_per_cmh2o);
    let flow = valve.max_flow_l_per_s;
    let spike = 1000.0 * f64::from(pressure_monitor::SPIKE);
    let delay = bench.sensor.lag_ms + spike + valve.dead_time_ms + valve.lag_ms;
    let rise = |compliance: f64| tenths(flow * delay / (circuit + compliance));
    vec![
        says(
            "the reading (sensor lag {} ms, and {} ms to reject noise), the valve's dead time ({} ms), and \
             the valve's lag ({} ms,",
            [number(bench.sensor.lag_ms), number(spike), number(valve.dead_time_ms), number(valve.lag_ms)],
        ),
        says("together {} ms.", [number(delay)]),
        says("At full flow, {} L/s, {} mL arrive in that time", [number(flow), whole(flow * delay)]),
        says("The circuit ({} mL/cmH2O) and a lung", [number(circuit)]),
        says("rises by at most {} cmH2O at C 10 and {} at C 50", [rise(10.0), rise(50.0)]),
        says("the pressure rises by {} cmH2O per ms", [tenths(flow / circuit)]),
        says(
            "slope is extrapolated by {} ms (smoothing costs about {} ms of these)",
            [number(pressure_monitor::AHEAD), number(1.0 / pressure_monitor::SLOPE_SHARE)],
        ),
        says(
            "more than {} cmH2O above the limit for {} ms",
            [number(pressure_monitor::AHEAD_ABOVE), number(spike)],
        ),
        says("valve, with a lag of {} ms, releases", [number(bench.expiratory.lag_ms)]),
    ]
}

/// Bounds of the pressure.
fn bounds() -> Vec<Claim> {
    let (_, offset) = Quantity::SensorZero.bounds();
    let (smallest, largest) = Quantity::SensorGain.bounds();
    let limit = f64::from(Settings::default().pressure_limit);
    let latest = limit * f64::from(largest) + f64::from(offset);
    vec![
        says("change the command by up to {} %)", [number(COMMAND_MAX)]),
        says("The bound is {} cmH2O above the limit", [number(torture::ABOVE_LIMIT)]),
        says(
            "by at most {} cmH2O and a factor of {} to {}, bounds",
            [number(offset), number(smallest), number(largest)],
        ),
        says(
            "pressure of {} times the limit plus {} cmH2O ({} cmH2O for the default of {})",
            [number(largest), number(offset), whole(latest), number(limit)],
        ),
        says("reveals a difference of more than {} cmH2O", [number(DOUBTFUL)]),
    ]
}

/// What no monitor detects.
fn not_covered() -> Vec<Claim> {
    let blocks = trigger::OPENING + trigger::LINE.0 + trigger::GAP + 1;
    let compliances =
        BenchConfig::paper_lungs().into_iter().map(|lung| lung.lung.first.compliance_ml_per_cmh2o);
    let flow = BenchConfig::default().valve.max_flow_l_per_s;
    let hang = f64::from(WATCHDOG_MAX_US) / 1000.0;
    vec![
        says("an offset of less than {} cmH2O", [number(DOUBTFUL)]),
        says("hides another {} cmH2O per L/s", [number(TUBE)]),
        says("Efforts in the first {} s after", [number(blocks as f64 * f64::from(trigger::BLOCK))]),
        says("freezes at less than {} cmH2O above PEEP", [number(expected::ABOVE)]),
        says("the softest lung ({} mL/cmH2O)", [number(1.0 / lung_estimator::SOFTEST)]),
        says("stiffer than the paper's (C {})", [number(compliances.fold(f64::INFINITY, f64::min))]),
        says("In {} ms that is {} mL, and", [number(hang), whole(flow * hang)]),
    ]
}

/// A constant of the self-test's checks that move the valves.
fn manoeuvre(name: &str) -> String {
    number(quoted("shared/src/device/self_test/manoeuvre.rs", &format!("const {name}: f32 = {{}};")))
}

/// The check of the circuit.
fn circuit_check() -> Vec<Claim> {
    vec![
        says(
            "test lung | {} % command: the pressure rises by {} cmH2O within {} s;",
            ["FILL", "RISE", "FILL_MAX"].map(manoeuvre),
        ),
        says(
            "closed it rises by at most {} cmH2O more in {} s, and never to more than {} above rest;",
            ["CHANGE", "HOLD", "RISE_MAX"].map(manoeuvre),
        ),
        says(
            "within {} s of opening the expiratory valve it is at most {} above rest",
            ["RELEASE", "LEFT"].map(manoeuvre),
        ),
        says("pressure changes by at most {} cmH2O in {} s;", ["CHANGE", "HOLD"].map(manoeuvre)),
    ]
}

/// The check of the relief valve, and the end of every check.
fn relief_check() -> Vec<Claim> {
    vec![
        says("at {} % command the pressure stops", ["FILL"].map(manoeuvre)),
        says("a pressure of {} cmH2O ends a check", ["CEILING"].map(manoeuvre)),
    ]
}

/// What the chip does by itself.
fn chip() -> Vec<Claim> {
    let longest = || minutes(LONGEST_ABSENCE_S);
    vec![
        says("pause the sounder for at most {} s", [number(AUDIO_PAUSE_MAX)]),
        says("for up to {} minutes |", [longest()]),
        says("if the supply returns within {} minutes", [longest()]),
    ]
}

/// Room in flash that a board must have.
fn flash() -> Vec<Claim> {
    let stored = [SLOT_BYTES, Keeper::BYTES, RECORD_BYTES as u32];
    vec![says("A slot uses {} bytes, a copy {} and a calibration {}, but", stored.map(grouped))]
}
