//! The table of alarms: what the chip acts on, and the conditions that begin and end each alarm, with the
//! numbers of the constants that act.

use std::fmt::Write as _;

use super::figures::{ms, number, percent};
use shared::safety::alarms::{ALARMS, Fault};
use shared::safety::expected::{ABOVE, AWAY};
use shared::safety::host::SILENCE_MAX;
use shared::safety::ladder::{CLEAN_BREATHS, LEARNED_STRIKES};
use shared::safety::plateau::{self, APART_BREATHS, DOUBTFUL};
use shared::safety::source::{
    AGREE, AGREED_BREATHS, APART, DOUBTFUL_BREATHS, FAR_APART, FOLLOWS, MOVED, SOUND_AGAIN, STOOD,
};
use shared::safety::volumes::{self, MEASURED};
use shared::safety::{
    backup, breath_monitor as breath, expiration, flow_monitor, lung_estimator as lung,
    pressure_monitor as pressure,
};
use shared::safety::{
    reading_monitor as reading, reference_volume as reference, standing, supervisor, volume_monitor as volume,
};

/// An alarm, the condition that begins it and the event that ends it.
type Conditions = (Fault, String, String);

const GONE: &str = "gone";
const ACKNOWLEDGED: &str = "an operator acknowledges, or the device restarts";

/// The table, in the order of the alarms.
pub fn table() -> String {
    let mut table =
        "| alarm | priority | action | entry | exit | text |\n|---|---|---|---|---|---|\n".to_owned();
    let conditions = conditions();
    for alarm in &ALARMS {
        let priority = alarm.priority.name();
        let (id, action, text) = (alarm.id, alarm.action.name(), alarm.text);
        let row = conditions.iter().find(|(fault, ..)| *fault == alarm.fault);
        let (_, entry, exit) = row.unwrap_or_else(|| panic!("alarm_table.rs lacks the conditions of `{id}`"));
        writeln!(table, "| `{id}` | {priority} | {action} | {entry} | {exit} | {text} |").unwrap();
    }
    table
}

fn conditions() -> Vec<Conditions> {
    let about_gas = [gas(), volumes(), references()].concat();
    [sensors(), responses(), limits(), baselines(), inspirations(), ladder(), device(), about_gas].concat()
}

fn clean_breaths() -> String {
    format!("one step up after {CLEAN_BREATHS} clean breaths (more after each return)")
}

/// What a single pressure sensor does.
fn sensors() -> Vec<Conditions> {
    let as_nan = "as `reading-nan`, with most missing readings";
    let (lowest, highest) = reading::SENSOR_RANGE;
    let entries = [
        (
            Fault::ReadingNotANumber,
            format!(
                "no number for {} ms, or more than {} % of the readings missing",
                ms(reading::MISSING),
                percent(1.0 / f64::from(1 + reading::MAKE_UP))
            ),
        ),
        (
            Fault::ReadingOutOfRange,
            format!("{as_nan} outside {} to {} cmH2O", number(lowest), number(highest)),
        ),
        (
            Fault::ReadingJumps,
            format!("{as_nan} more than {} cmH2O per ms from the last good one", number(reading::JUMP_MAX)),
        ),
        (
            Fault::ReadingFrozen,
            format!(
                "the same reading, to the last bit, for {} ms in which it must change: the other pressure \
                 sensor moves by more than {} cmH2O, gas flows in more than {} below the target, or out \
                 more than {} above PEEP",
                ms(reading::FROZEN),
                number(MOVED),
                number(AWAY),
                number(ABOVE)
            ),
        ),
        (
            Fault::OutletSensorLost,
            "the outlet's pressure sensor fails one of the checks named `reading-`".to_owned(),
        ),
    ];
    let sound = format!("the sensor is sound for {} s", number(SOUND_AGAIN));
    entries.map(|(fault, entry)| (fault, entry, sound.clone())).to_vec()
}

/// Sensors that are noisy, disagree or do not respond.
fn responses() -> Vec<Conditions> {
    let noisy = format!(
        "noise of more than {} cmH2O (standard deviation), averaged over about {} ms; the cap applies if \
         the other pressure sensor is not sound",
        number(reading::NOISE_MAX),
        number(1.0 / reading::NOISE_SHARE)
    );
    let disagree = format!(
        "the pressure sensors more than {} cmH2O apart for {} ms (the higher one counts, or while gas goes in the \
         one that follows it, until the end of the expiration), more than {} at the \
         end of {DOUBTFUL_BREATHS} expirations in a row (the one closer to PEEP counts), or more than {} and {} % \
         at the end of {APART_BREATHS} inspirations in a row (the one that fits the gas counts); or an inspiration has \
         changed one by less than {} and the other by more than {} and the drop in the tube (that one counts); or \
         {cuts} breaths in a row end at the pressure limit, above which only one sensor is, by more than {} and at the outlet by the drop in the tube more",
        number(FAR_APART),
        ms(APART),
        number(DOUBTFUL),
        number(DOUBTFUL),
        percent(plateau::GAIN),
        number(STOOD),
        number(FOLLOWS),
        number(DOUBTFUL),
        cuts = supervisor::CUTS_MAX
    );
    let no_response = format!(
        "for {} ms less than {} % of a predicted rise of more than {} cmH2O, or for {} ms no change over \
         the last {} ms although such a rise is predicted; not if two pressure sensors agree, the gas \
         reaches the patient, and the pressure is up, less than {} cmH2O are missing, the lung refills after \
         a strain, or it has not been estimated from {} inspirations, at least one begun by the clock; nor if \
         they have fallen by more than {}. If gas may have been lost, the inspiration ends, and its expiration \
         tells: only gas that comes back should have raised the pressure. Or no change by more than {} \
         cmH2O in an inspiration from more than {} above PEEP whose gas raises the pressure by {}, or in an \
         expiration whose gas lowers it by {}; or such a pressure at the end of {} expirations in a row, or one \
         {} above PEEP that leaves less than {} % of the rise for a breath when no gas flows out any more, of which the gas in \
         the lung explains less than {} %",
        ms(lung::UNANSWERED),
        percent(lung::ANSWER),
        number(lung::TELLING_RISE),
        ms(lung::STANDING),
        lung::WINDOW,
        number(supervisor::EFFORT),
        lung::KNOWN,
        number(breath::ABOVE_PEEP),
        number(standing::MOVES),
        number(breath::ABOVE_PEEP),
        number(lung::TELLING_RISE),
        number(standing::FALL),
        expiration::IN_A_ROW,
        number(supervisor::LEAST_BASELINE),
        percent(supervisor::ROOM),
        percent(standing::EXPLAINED)
    );
    let backup = "no pressure sensor is sound, or none responds: the volume of the last good breaths is \
                  delivered, or without a sound flow sensor their mean commands are repeated";
    let agree = number(AGREE);
    vec![
        (Fault::ReadingNoisy, noisy, clean_breaths()),
        (
            Fault::SensorsDisagree,
            disagree,
            format!("less than {agree} cmH2O apart at the end of {AGREED_BREATHS} expirations in a row"),
        ),
        (
            Fault::NoResponse,
            no_response,
            format!("{} inspirations in a row raise the pressure", supervisor::RESPONSES),
        ),
        (Fault::BackupVentilation, backup.to_owned(), "a pressure sensor is sound and responds".to_owned()),
    ]
}

/// A pressure above its limits.
fn limits() -> Vec<Conditions> {
    let high = format!(
        "{} breaths in a row end at the pressure limit, or one does so under the capped PID because of its \
         gas, or {} s above the limit with the expiratory valve commanded open",
        supervisor::CUTS_MAX,
        number(pressure::VENTING)
    );
    let hard = format!(
        "{} s above the limit with the expiratory valve commanded open, in which less than {} mL come out, or \
         {} s whatever the flow sensor shows",
        number(pressure::VENTING),
        number(pressure::OUTFLOW),
        number(pressure::STRAIN)
    );
    let sustained = format!(
        "more than {} cmH2O above PEEP for {} s, and with the expiratory valve commanded open a fall of \
         less than {} % of that in {fall} s and in {fall} s after that ({} s without a sound flow sensor); not \
         if the flow sensor shows that the gas comes out; or less than {} % of the inspired volume coming \
         out ({} % without the gas of a known leak), {} % of it staying in the lung and the pressure falling by less than {} (in \
         {} breaths in a row if an effort ends the last one)",
        number(pressure::BACK_AT_PEEP),
        number(pressure::SUSTAINED),
        percent(pressure::FALLS),
        number(pressure::FALL_UNSEEN),
        percent(volumes::BLOCKED),
        percent(volumes::BLOCKED_WITHOUT_LEAK),
        percent(supervisor::FILLS),
        number(standing::FALL),
        supervisor::FILLED,
        fall = number(pressure::FALL),
    );
    vec![
        (Fault::HighPressure, high, GONE.to_owned()),
        (Fault::HardLimit, hard, ACKNOWLEDGED.to_owned()),
        (Fault::SustainedPressure, sustained, ACKNOWLEDGED.to_owned()),
    ]
}

/// The ends of expirations.
fn baselines() -> Vec<Conditions> {
    let high = format!(
        "more than {} cmH2O above PEEP at the end of {} expirations in a row, or of {} if efforts end them \
         early; then an expiration in which the pressure still falls lasts up to {} % of a breath longer, \
         and PIP rises with a constant baseline, up to {} cmH2O below the limit, if the gas comes out and the \
         pressure swings with the breath",
        number(breath::ABOVE_PEEP),
        breath::HIGH_BREATHS,
        breath::TRAPPED_BREATHS,
        percent(1.0 / f64::from(expiration::LONGER)),
        number(expiration::BELOW_LIMIT)
    );
    let low = format!(
        "more than {} cmH2O below PEEP at the end of {} breaths in a row, none of them cut at the limit or \
         drawn down by more than {} within {} s, or {} in a row with a command of more than {} % above the bias that holds PEEP no higher than {} below, without an effort",
        number(breath::BELOW_PEEP),
        breath::LOW_BREATHS,
        number(breath::DRAWN),
        number(expiration::RECENT),
        expiration::LEAKS,
        number(expiration::HELD),
        number(expiration::HELD_BELOW)
    );
    vec![(Fault::BaselineHigh, high, GONE.to_owned()), (Fault::BaselineLow, low, GONE.to_owned())]
}

/// Inspirations that do not fill the lung.
fn inspirations() -> Vec<Conditions> {
    let low = format!(
        "less than {} % of the rise from PEEP to PIP, with a command above {} %, at the end of {} \
         inspirations in a row; or less than {} % of it while a noisy reading caps the command",
        percent(breath::REACHED),
        number(breath::WIDE_OPEN),
        breath::WEAK_BREATHS,
        percent(breath::CAPPED)
    );
    let disconnection = format!(
        "{} s of inspirations ({} s with a capped command) at less than {} % of PEEP and more than {} cmH2O \
         below it, with a command above {} %, unless the flow sensor shows no flow to the patient; or an inspiration \
         that ends at such a pressure, or below {} cmH2O, less than {} % of whose gas comes back by the end \
         of the breath, or within {} s, if that is at least {} % of the valve's and no strain has pressed it \
         out before; until the \
         patient is back, the PID probes with a capped command",
        number(breath::DISCONNECTED),
        number(breath::SLOW_DISCONNECTED),
        percent(breath::OPEN_END),
        number(breath::BELOW_PEEP),
        number(breath::FILLING),
        number(breath::ROOM),
        percent(breath::COMES_BACK),
        number(breath::RETURNS),
        percent(breath::PASSES)
    );
    let occlusion = format!(
        "in {} breaths in a row less than {} % of the volume per pressure rise of the last good breaths, \
         and less than {} % of the gas reaches the patient or comes out again; in {} breaths in a row if \
         more does, but less than {} % comes out again; in backup ventilation {} breaths with less than {} % \
         of the usual inspired volume",
        breath::OCCLUDED_BREATHS,
        percent(breath::OCCLUDED),
        percent(breath::PASSES),
        breath::NARROWED_BREATHS,
        percent(breath::OPEN),
        flow_monitor::BLOCKED_BREATHS,
        percent(flow_monitor::GETS_THROUGH)
    );
    let back = format!(
        "the pressure of an inspiration is above PEEP again, and above {} cmH2O",
        number(breath::CLOSED)
    );
    vec![
        (Fault::LowPressure, low, GONE.to_owned()),
        (Fault::Disconnection, disconnection, back),
        (Fault::Occlusion, occlusion, GONE.to_owned()),
    ]
}

/// Steps down the ladder.
fn ladder() -> Vec<Conditions> {
    let missed = format!(
        "{} control ticks missed within a breath, or one in each of {} in a row (the PID controls from the first one on)",
        supervisor::MISSED_MAX,
        supervisor::MISSED_BREATHS
    );
    let distrusted = format!(
        "{LEARNED_STRIKES} breaths in a row, or one with less than {} % of the good breaths' gas, end at the \
         pressure limit under the selected controller because of their gas",
        percent(backup::LITTLE)
    );
    let capped = format!(
        "a breath ends at the pressure limit under the PID because of its gas; or {} in a row do, under any controller, \
         with less than {} % of the last good breaths' gas in the patient",
        supervisor::CUTS_MAX,
        percent(backup::LITTLE)
    );
    let steps = [
        (Fault::MissedTicks, missed),
        (Fault::LearnedDistrusted, distrusted),
        (Fault::CommandCapped, capped),
    ];
    let exit = |fault| match fault {
        Fault::CommandCapped => format!(
            "{}, or a breath with less than {} % of its rise",
            clean_breaths(),
            percent(supervisor::RESPONSE)
        ),
        _ => clean_breaths(),
    };
    steps.map(|(fault, entry)| (fault, entry, exit(fault))).to_vec()
}

/// The device and its host.
fn device() -> Vec<Conditions> {
    let silent = number(SILENCE_MAX);
    let rows = [
        (
            Fault::HostSilent,
            format!(
                "{silent} s without a request of the host that steers while ventilating; ventilation continues, exploration \
                 ends"
            ),
            "its next request, or that of a host that takes over",
        ),
        (
            Fault::WeightsRefused,
            "at start-up a slot holds torn or damaged weights; the other slot's weights or the PID run"
                .to_owned(),
            "valid weights are stored in that slot",
        ),
        (
            Fault::Restarted,
            "a reset by the watchdog or a supply dip, or any reset or power cut during ventilation; above \
             is when it resumes"
                .to_owned(),
            "an operator acknowledges",
        ),
    ];
    rows.map(|(fault, entry, exit)| (fault, entry, exit.to_owned())).to_vec()
}

/// Gas that is lost or does not move, and its sensor.
fn gas() -> Vec<Conditions> {
    let leak = format!(
        "less than {} % of the inspired volume comes out in {} breaths in a row, or less than {} % if \
         holding PEEP takes a command of more than {} % above the bias; not if more flows out at the end of \
         each of them than of the one before, or a strain has pressed the gas out before: the lung fills",
        percent(expiration::OPEN),
        expiration::LEAKS,
        percent(expiration::TIGHT),
        number(expiration::LEAK)
    );
    let (seconds, breaths) = volume::APNOEA;
    let apnoea = format!(
        "no breath of {} mL in and out for {} s, or for {} breaths if these take longer; time in which gas \
         goes one way only counts {} %",
        number(volume::DELIVERED),
        number(seconds),
        number(breaths),
        percent(volume::ONE_WAY)
    );
    let lost = format!(
        "no number in more than {} % of a breath's flow readings; or the same reading throughout a breath, \
         or for {} s from a sensor with noise, volumes in {} breaths in a row that the valve's gas contradicts, {} if they \
         hardly swing, or more than {} L/s out than in for {} breaths; volumes and leaks are not monitored until it is back",
        percent(1.0 - MEASURED),
        number(flow_monitor::STANDS),
        number(flow_monitor::BELIED),
        number(flow_monitor::BELIED_STILL),
        number(flow_monitor::NET),
        number(flow_monitor::ONLY_OUT)
    );
    vec![
        (Fault::Leak, leak, GONE.to_owned()),
        (Fault::Apnoea, apnoea, "a breath of such a volume".to_owned()),
        (
            Fault::FlowSensorLost,
            lost,
            format!(
                "a breath with flow readings; after wrong ones, {} s of sound breaths",
                number(flow_monitor::SOUND)
            ),
        ),
    ]
}

/// Volumes that have fallen below what they were.
fn references() -> Vec<Conditions> {
    let ((breaths, seconds), falls) = (reference::GROUP, percent(reference::FALLS));
    let fall = format!(
        "for {} s the largest of {breaths} breaths in a row, or of the breaths of {} s if these are more, is less \
         than {falls} % of what the smallest such group of earlier minutes lets expect; one group is enough if \
         it is less than {} %",
        number(reference::LASTS),
        number(seconds),
        percent(reference::LOST)
    );
    let lost = format!(
        "less than {} % of that in {} such groups in a row, or less than {falls} % for {} s",
        percent(reference::LOST),
        reference::LOST_GROUPS,
        number(reference::PERSISTS)
    );
    let exit = format!(
        "a larger breath in a group, or after {} s, from when on these volumes are the expected ones",
        number(reference::ADOPTED)
    );
    vec![(Fault::VentilationFalls, fall, exit.clone()), (Fault::VentilationLost, lost, exit)]
}

/// Volumes outside their limits.
fn volumes() -> Vec<Conditions> {
    let breaths = volume::BREATHS;
    let tidal = |side: &str, limit: &str| {
        format!(
            "an expired volume, and its mean with the inspired one, {side} `{limit}` in {breaths} \
                 breaths in a row"
        )
    };
    let minute = |side: &str, limit: &str| {
        let (averaged, restarted) = (number(volume::AVERAGED), number(volume::RESTARTED));
        format!(
            "in {breaths} breaths in a row an expired minute volume {side} `{limit}`, averaged over {averaged} s, or over \
             {restarted} s after the leak has changed"
        )
    };
    let rows = [
        (Fault::TidalVolumeLow, tidal("below", "tidal_volume_low")),
        (Fault::TidalVolumeHigh, tidal("above", "tidal_volume_high")),
        (Fault::MinuteVolumeLow, minute("below", "minute_volume_low")),
        (Fault::MinuteVolumeHigh, minute("above", "minute_volume_high")),
    ];
    rows.map(|(fault, entry)| (fault, entry, GONE.to_owned())).to_vec()
}
