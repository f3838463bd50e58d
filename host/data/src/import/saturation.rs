//! Measures how often a valve is at an end of the range in use.

/// Counts for one valve, table by table, because tables may come from different ventilators.
#[derive(Debug, Default)]
pub(super) struct Saturation {
    low: RangeEnd,
    high: RangeEnd,
    rows: usize,
    /// Totals over the previous tables.
    past_saturated: usize,
    past_rows: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct RangeEnd {
    command: f64,
    rows: usize,
}

impl Saturation {
    pub(super) fn add(&mut self, command: f64) {
        if self.rows == 0 || command < self.low.command {
            self.low = RangeEnd { command, rows: 0 };
        }
        if self.rows == 0 || command > self.high.command {
            self.high = RangeEnd { command, rows: 0 };
        }
        self.rows += 1;
        self.low.rows += usize::from(command <= self.low.command);
        self.high.rows += usize::from(command >= self.high.command);
    }

    /// A valve that never moved in a table was not in use.
    pub(super) fn end_of_table(&mut self) {
        if self.low.command < self.high.command {
            self.past_saturated += self.low.rows + self.high.rows;
            self.past_rows += self.rows;
        }
        self.rows = 0;
    }

    /// Share of the rows at either end, over the tables in which the valve is used, 0..1.
    pub(super) fn share(&self) -> f64 {
        self.past_saturated as f64 / self.past_rows.max(1) as f64
    }
}
