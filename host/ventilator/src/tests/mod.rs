//! Tests of sources: devices, plants in other processes, the bench behind the plant line.

mod device;
mod newborns;
mod plant_link;
