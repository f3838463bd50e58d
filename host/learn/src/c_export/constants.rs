//! The parts of the templates that are the core's constants or a controller's.

use shared::breath::{Breath, period_s};
use shared::control::COMMAND_MAX;
use shared::control::features::{
    AVERAGES, COMMAND_SCALE, ERROR_SCALE, FEATURES, PEEP_SCALE, PIP_SCALE, TAP_MAX,
};
use shared::control::memory::{
    BINS, COMMANDS_AHEAD, ERRORS_AHEAD, LEARNING, LEAST_BINS, NEWEST, PIECES, RECALLED, SECTIONS, SMALL_STEP,
    SURPRISE, bin_ticks,
};
use shared::control::network::{Dense, HIDDEN_1, HIDDEN_2, INPUTS, Network};
use shared::control::residual::Residual;
use shared::safety::slew::Slew;
use shared::sensor::HIGHEST_PRESSURE;
use shared::settings::{FIELDS, Field, LEAST_RISE, LIMIT_MARGIN};
use shared::weights::Image;
use shared::weights::exercise::{SECOND_TICKS, START, TICKS, script};

use super::standalone::Standalone;
use super::text::{define, list, real, reals, wholes};
use super::trials::{LUNG_STEP, RIPPLE, Trial, checksums, trials};

/// The settings that a controller needs; the others are a supervisor's.
const SETTINGS: [&str; 8] = [
    "pip",
    "peep",
    "rate",
    "inspiratory_time",
    "rise_time",
    "fall_time",
    "expiratory_bias",
    "pressure_limit",
];
/// Those of them in which a small step keeps the memory.
const STEPPED: [&str; 2] = ["pip", "peep"];

fn fields() -> impl Iterator<Item = &'static Field> {
    FIELDS.iter().filter(|field| SETTINGS.contains(&field.name))
}

/// The parts by the names of their markers.
pub fn parts(image: &Image) -> Vec<(&'static str, String)> {
    let residual = &image.residual;
    let period_us = residual.spec().period_us;
    let section = |n: usize| format!("{{{}u, {}u}}", SECTIONS[n].bins, SECTIONS[n].width);
    let piece = |n: usize| {
        let piece = PIECES[n];
        format!("{{{}, {}u, {}}}", real(piece.from), piece.bin, real(piece.rate))
    };
    vec![
        ("period_us", period_us.to_string()),
        ("settings", members()),
        ("least_rise", LEAST_RISE.to_string()),
        ("limit_margin", LIMIT_MARGIN.to_string()),
        ("history", history().to_string()),
        ("averages", AVERAGES.to_string()),
        ("bins", BINS.to_string()),
        ("check_ticks", check_ticks(period_us).to_string()),
        ("constants", scalars(residual)),
        ("features", features(residual)),
        ("sections", list((0..SECTIONS.len()).map(section))),
        ("pieces", list((0..PIECES.len()).map(piece))),
        ("network", network(residual.network())),
        ("in_range", in_range()),
        ("others_stay", others_stay()),
        ("golden", golden(image)),
    ]
}

/// Entries of a signal's history.
fn history() -> u32 {
    u32::from(TAP_MAX) + 1
}

/// The members of the settings.
fn members() -> String {
    let member = |field: &Field| {
        let Field { name, description, unit, min, max, default, .. } = field;
        format!("  float {name};  /* {description}, {unit}: {min} to {max}, by default {default}. */")
    };
    fields().map(member).collect::<Vec<_>>().join("\n")
}

/// The condition that all settings are in their ranges.
fn in_range() -> String {
    let within =
        |field: &Field| format!("within(settings->{}, {}, {})", field.name, real(field.min), real(field.max));
    fields().map(within).collect::<Vec<_>>().join(" &&\n        ")
}

/// The condition that two settings differ at most in those of [`STEPPED`].
fn others_stay() -> String {
    let others = fields().filter(|field| !STEPPED.contains(&field.name));
    let stays = others.map(|Field { name, .. }| format!("settings->{name} == old->{name}"));
    stays.collect::<Vec<_>>().join(" &&\n         ")
}

/// Constants that are single numbers.
fn scalars(residual: &Residual) -> String {
    let (spec, pid) = (residual.spec(), residual.pid());
    let reals = [
        ("PERIOD", period_s(spec.period_us)),
        ("COMMAND_MAX", COMMAND_MAX),
        ("HIGHEST_PRESSURE", HIGHEST_PRESSURE),
        ("LEAST_RISE", LEAST_RISE),
        ("LIMIT_MARGIN", LIMIT_MARGIN),
        ("SMALL_STEP", SMALL_STEP),
        ("ERROR_SCALE", ERROR_SCALE),
        ("COMMAND_SCALE", COMMAND_SCALE),
        ("PIP_ZERO", PIP_SCALE.0),
        ("PIP_SCALE", PIP_SCALE.1),
        ("PEEP_ZERO", PEEP_SCALE.0),
        ("PEEP_SCALE", PEEP_SCALE.1),
        ("SURPRISE", SURPRISE),
        ("NEWEST", NEWEST),
        ("PROPORTIONAL", pid.gains().p),
        ("INTEGRAL_STEP", pid.integral_step()),
        ("DERIVATIVE_SCALE", pid.derivative_scale()),
        ("DERIVATIVE_FACTOR", pid.derivative_factor()),
        ("GAIN", spec.lambda * COMMAND_MAX),
        ("AUTHORITY", spec.authority),
        ("SLEW", Slew::new(spec.period_us).per_tick()),
    ];
    let wholes = [
        ("HISTORY", history()),
        ("AVERAGES", AVERAGES as u32),
        ("FEATURES", FEATURES as u32),
        ("RECALLED", RECALLED as u32),
        ("INPUTS", INPUTS as u32),
        ("HIDDEN_1", HIDDEN_1 as u32),
        ("HIDDEN_2", HIDDEN_2 as u32),
        ("BINS", BINS as u32),
        ("BIN_TICKS", bin_ticks(spec.period_us)),
        ("LEAST_BINS", LEAST_BINS as u32),
        ("LEARNING", u32::from(LEARNING)),
    ];
    let reals = reals.map(|(name, value)| define(name, real(value)));
    let wholes = wholes.map(|(name, value)| define(name, format_args!("{value}u")));
    reals.concat() + &wholes.concat()
}

/// Taps, factors and time constants.
fn features(residual: &Residual) -> String {
    let (features, spec) = (residual.features(), residual.features().spec());
    let ahead = |bins: &[usize]| bins.iter().map(|bins| *bins as f32).collect::<Vec<_>>();
    [
        wholes("ERROR_TAPS", &spec.error_taps),
        wholes("COMMAND_TAPS", &spec.command_taps),
        wholes("TARGET_AHEAD", &spec.target_ahead),
        reals("ERROR_FACTORS", features.error_factors()),
        reals("COMMAND_FACTORS", features.command_factors()),
        reals("TIMES", &spec.times),
        reals("ERRORS_AHEAD", &ahead(&ERRORS_AHEAD)),
        reals("COMMANDS_AHEAD", &ahead(&COMMANDS_AHEAD)),
    ]
    .concat()
}

fn network(network: &Network) -> String {
    layer(1, &network.hidden_1) + &layer(2, &network.hidden_2) + &layer(3, &network.output)
}

fn layer<const I: usize, const O: usize>(number: u32, layer: &Dense<I, O>) -> String {
    reals(&format!("WEIGHTS_{number}"), layer.weights.as_flattened())
        + &reals(&format!("BIAS_{number}"), &layer.bias)
}

/// Script, trials and results of the self-check.
fn golden(image: &Image) -> String {
    let readings: Vec<f32> = (0..TICKS).map(|tick| script(tick).pressure).collect();
    let first = script(0);
    let (factor, step, steps) = RIPPLE;
    [
        define("SCRIPT_START", real(START)),
        define("SCRIPT_PIP", real(first.pip)),
        define("SCRIPT_PEEP", real(first.peep)),
        define("SCRIPT_RISE_TICKS", format_args!("{}u", first.rise_ticks)),
        define("SCRIPT_LAST", format_args!("0x{:08x}u", image.golden.last)),
        define("SCRIPT_ALL", format_args!("0x{:08x}u", image.golden.all)),
        define("LUNG_STEP", real(LUNG_STEP)),
        define("RIPPLE", real(factor)),
        define("RIPPLE_STEP", format_args!("{step}u")),
        define("RIPPLE_PERIOD", format_args!("{steps}u")),
        wholes("SCRIPT_TICKS", &[TICKS, SECOND_TICKS]),
        reals("SCRIPT_PRESSURES", &readings),
        trial_table(image),
    ]
    .concat()
}

/// The trials and the checksums of their commands.
fn trial_table(image: &Image) -> String {
    let period_us = image.residual.spec().period_us;
    let row = |(trial, checksum): (&Trial, u32)| {
        let settings = list(fields().map(|field| real(field.value(&trial.settings))));
        let tick =
            trial.fault_tick(period_us).map_or_else(|| "UINT32_MAX".to_owned(), |tick| format!("{tick}u"));
        let reading = trial.fault.unwrap_or_default().to_bits();
        format!("  {{{{{settings}}}, {}, {tick}, 0x{reading:08x}u, 0x{checksum:08x}u}},\n", real(trial.gain))
    };
    let trials = trials();
    let checksums = checksums(&Standalone::new(&image.residual), period_us);
    let rows: String = trials.iter().zip(checksums).map(row).collect();
    format!("static const struct trial TRIALS[] = {{\n{rows}}};\n")
}

/// Ticks of inspiration in a self-check; the others cost next to nothing.
fn check_ticks(period_us: u32) -> u32 {
    let ticks = |trial: &Trial| {
        Breath::new(&trial.settings, period_us).map_or(0, |breath| breath.inspiration_ticks())
    };
    TICKS + SECOND_TICKS + trials().iter().map(ticks).sum::<u32>()
}
