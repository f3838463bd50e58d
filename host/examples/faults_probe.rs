//! probe
use host::bench::BenchConfig;
use host::faults::matrix::matrix;
use host::faults::torture::Torture;
use host::watch::Watch;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
fn main() {
    let lungs = BenchConfig::paper_lungs();
    for row in matrix(&lungs, &[1, 2], Monitors::ALL, &Watch::silent()).unwrap() {
        if std::env::args().len() > 1 || !row.pass {
            println!(
                "{} {:45} {:7} {:?} detect {:?} {:?} peak {:.1}/{} back {:?} vent {:?} {:?}",
                if row.pass { "ok  " } else { "FAIL" },
                row.fault,
                row.lung,
                row.monitor,
                row.detect_ms,
                row.action,
                row.peak_true,
                row.peak_allowed,
                row.back_at_peep_ms,
                row.limit_to_vent_ms,
                row.alarms
            );
        }
    }
    let alarms = host::faults::matrix::false_alarms(
        &lungs,
        1120,
        &host::faults::matrix::sound_pid().unwrap(),
        &Watch::silent(),
    )
    .unwrap();
    println!("false alarms {} {:?}", alarms.len(), &alarms[..alarms.len().min(30)]);
    for f in Fault::all() {
        let rows = matrix(&lungs[4..5], &[1], Monitors::ALL.without(f), &Watch::silent()).unwrap();
        let failed: Vec<_> = rows.iter().filter(|r| !r.pass).map(|r| r.fault).collect();
        println!("without {:?}: {:?}", f, failed);
    }
    let mut t = Torture::new(1);
    t.advance::<host::source::SourceError>(20_000, &Watch::silent(), &mut |_| Ok(())).unwrap();
    println!("{t:?}");
}
