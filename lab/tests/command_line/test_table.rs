//! The pressure-control test table.

use super::support::{Place, text};

#[test]
fn every_row_passes_with_the_shipped_controllers() {
    let rows = Place::new().json("test-table --seed 5");
    let rows = rows.as_array().unwrap();
    assert_eq!(rows.len(), 21);
    for row in rows {
        assert_eq!(row["pass"], true, "{row}");
        let newborn = row["row"].as_u64().unwrap() >= 9;
        assert_eq!(row["machine"], if newborn { "neonate" } else { "adult" });
    }
}

#[test]
fn the_exit_status_says_that_rows_fail() {
    let place = Place::new();
    let output = place.run(&format!("test-table --neonate {}", place.controller()));
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("of 21 rows fail"), "{}", text(&output.stderr));
}
