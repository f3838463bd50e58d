//! `cargo xtask papers`: the papers that an auditor asks for, generated from the code, its tests and their last results.
//!
//! | paper | content | module |
//! |---|---|---|
//! | `trace.md` | requirement, hazard, code, test, last result | [`trace`], from [`safety`] and [`marks`] |
//! | `tests.md` | measured values beside their limits | [`report`], from [`results`] |
//! | `soup.md` | third-party crates of the chip's image; licences and advisories | [`software`], [`deny`] |
//! | `sbom-*.cdx.json` | the parts of chip and host, for machines | [`sbom`] |
//! | `standards.md` | what there is for the headings of the standards, and what is missing | [`standards`] |
//!
//! A unit test in [`trace`] holds requirements, code and tests to one another.

mod deny;
mod marks;
mod report;
pub mod results;
mod safety;
pub mod sbom;
mod software;
mod standards;
mod trace;

use anyhow::{Result, ensure};
use xshell::{Shell, cmd};

use deny::Advisories;
use report::table;
use results::{FAULTS, date, now};
use safety::{DOCUMENT, Safety};
use software::Program;

/// Names of the papers' files.
const PAPERS: [&str; 4] = ["trace.md", "tests.md", "soup.md", "standards.md"];

/// Writes the papers; fails if a requirement, a licence or an advisory is at fault.
pub fn run(shell: &Shell) -> Result<()> {
    let (folder, results) = (results::papers(shell), results::folder(shell));
    let (revision, steps) = (results::revision(shell), results::steps(&results)?);
    let safety = Safety::read(&shell.read_file(DOCUMENT)?)?;
    let marks = marks::all(&shell.current_dir())?;
    let chip = software::chip(shell)?;
    let advisories = deny::advisories(shell)?;
    let trace = trace::matrix(&safety, &marks, FAULTS.last(&results)?.as_ref(), &steps);
    let compiler = cmd!(shell, "rustc --version").quiet().read()?;
    let papers = [
        ("Trace matrix", trace),
        ("Test report", report::report(&shell.current_dir(), &results, &steps)?),
        ("Software of unknown provenance in the chip's image", soup(&chip, &compiler, &advisories)),
        ("Standards", standards::standards()?),
    ];
    let (now, today) = (now(), date(now()));
    for ((title, text), file) in papers.iter().zip(PAPERS) {
        let head =
            format!("# {title}\n\nEupnea, revision {revision}, written {today} by `cargo xtask papers`.\n\n");
        shell.write_file(folder.join(file), head + text)?;
    }
    for (file, list) in sbom::lists(shell, &revision, now)? {
        shell.write_file(folder.join(file), list)?;
    }
    println!("papers of revision {revision} in {}", folder.display());
    deny::check(shell)?;
    let gaps = trace::gaps(&safety, &marks);
    ensure!(gaps.is_empty(), "the trace matrix has gaps:\n{}", gaps.join("\n"));
    match advisories {
        Advisories::Unreachable(why) => {
            println!("advisories not checked, the database is out of reach: {why}");
        }
        Advisories::Found(found) => ensure!(found.is_empty(), "known advisories:\n{}", found.join("\n")),
    }
    Ok(())
}

/// The list of third-party crates.
fn soup(chip: &Program, compiler: &str, advisories: &Advisories) -> String {
    let rows = chip.soup().map(|(id, part)| {
        let users = chip.users(id).join(", ");
        vec![id.0.clone(), id.1.clone(), part.licence.clone(), users, part.description.clone()]
    });
    let list = table(&["crate", "version", "licence", "used by", "for"], rows);
    let several = chip.several().into_iter().collect::<Vec<_>>().join(", ");
    let today = date(now());
    let advisories = match advisories {
        Advisories::Unreachable(why) => {
            format!("Not checked: on {today} the database of RustSec was out of reach ({why}).")
        }
        Advisories::Found(found) if found.is_empty() => {
            format!("None in the database of RustSec on {today}.")
        }
        Advisories::Found(found) => {
            format!("In the database of RustSec on {today}, of chip and host:\n\n* {}", found.join("\n* "))
        }
    };
    format!(
        "The core library is that of {compiler}. The crates are those that cargo resolves for the image; the linker may keep little of \
         one. `used by` names the crates that use each, of which `firmware` and `shared` are the project's own; `for` quotes its \
         authors. Licences are checked against deny.toml.\n\n{list}\nIn several versions: {several}.\n\n## Known advisories\n\n{advisories}\n"
    )
}
