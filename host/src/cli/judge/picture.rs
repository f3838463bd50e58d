//! Pictures of sore spots: the worst breath with target and pressure above, valve commands below.

use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::command::write;
use data::recording::Recording;
use show::report::{Plot, Role, Series, Style};
use verdict::{Judged, SoreSpot, Verdict};

/// Sizes of the two plots of a picture, pixels; wide enough for the title.
const ABOVE: (u32, u32) = (1000, 400);
const BELOW: (u32, u32) = (1000, 240);

/// Draws the `worst` sore spots of a file into a folder; returns the paths.
pub fn draw(
    folder: &Path,
    file: &Path,
    recording: &Recording,
    verdict: &Verdict,
    worst: usize,
) -> anyhow::Result<Vec<PathBuf>> {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let mut paths = Vec::new();
    for (n, spot) in verdict.sore_spots.iter().take(worst).enumerate() {
        let words = format!("{stem} {:02} {} breath {} {}", n + 1, spot.lung, spot.breath, spot.kind.name());
        let path = folder.join(file_name(&words));
        write(&path, Plot::stacked(&plots(recording, verdict, spot))?.as_bytes())?;
        paths.push(path);
    }
    Ok(paths)
}

/// A name of letters and digits, which every file system accepts.
fn file_name(words: &str) -> String {
    let parts =
        words.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).filter(|part| !part.is_empty());
    format!("{}.svg", parts.collect::<Vec<_>>().join("-"))
}

/// Target and pressure with a mark at the sore spot, and the commands.
fn plots(recording: &Recording, verdict: &Verdict, spot: &SoreSpot) -> [Plot; 2] {
    let rows = verdict.breaths[spot.worst].rows.clone();
    let pressure = match (verdict.judged, &recording.pressure_true) {
        (Judged::True, Some(pressure)) => pressure,
        _ => &recording.pressure,
    };
    let points = |column: &[f32]| points(recording, column, rows.clone());
    let curve = points(pressure);
    let mark = curve.iter().find(|(time, _)| *time >= spot.at_s).or(curve.last()).copied();
    let mut series = vec![
        Series::new("target", Style::Dashed, points(&recording.target)),
        Series::new("pressure", Style::Line, curve),
    ];
    series.extend(mark.map(|mark| Series {
        role: Some(Role::Limit),
        ..Series::new(spot.kind.name(), Style::Points, vec![mark])
    }));
    let mut commands = vec![Series::new("inspiratory valve", Style::Step, points(&recording.u_in))];
    commands.push(Series::new("expiratory valve", Style::Step, points(&recording.u_out)));
    if let Some(oxygen) = &recording.u_psol {
        commands.push(Series::new("oxygen valve", Style::Step, points(oxygen)));
    }
    let below = Plot {
        size: Some(BELOW),
        y_range: Some((0.0, 100.0)),
        ..Plot::over_time("", "command, %", commands)
    };
    let title = format!("{}, breath {}: {}", spot.lung, spot.breath, spot.what);
    [Plot { size: Some(ABOVE), ..Plot::over_time(title, "pressure, cmH2O", series) }, below]
}

/// A column over the time since the start of its breath.
fn points(recording: &Recording, column: &[f32], rows: Range<usize>) -> Vec<(f64, f64)> {
    let period_s = recording.provenance.period_s();
    rows.map(|row| (f64::from(recording.tick[row]) * period_s, f64::from(column[row]))).collect()
}
