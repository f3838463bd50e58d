//! The description of an FMU: `modelDescription.xml`.

use shared::settings::{FIELDS, Field, Settings};

use crate::resources::Resources;
use crate::variables::{DEFAULT_SEED, OUTPUTS, Output, SEED, SETTINGS};

/// Name of the library in an FMU, without its ending.
pub const LIBRARY: &str = "eupnea";

/// The description of the FMU with these resources.
pub fn description(resources: &Resources) -> String {
    let settings = FIELDS.iter().enumerate().map(|(reference, field)| setting(reference, field));
    let outputs = OUTPUTS.iter().enumerate().map(|(index, found)| output(SETTINGS + index, found));
    let variables: Vec<String> = settings.chain(outputs).collect();
    // Numbered from 1; the seed is the last one.
    let unknowns: Vec<String> = (SETTINGS..SETTINGS + OUTPUTS.len())
        .map(|index| format!("      <Unknown index=\"{}\"/>\n", index + 1))
        .collect();
    let unknowns = unknowns.concat();
    let step = f64::from(resources.image.residual.spec().period_us) * 1.0e-6;
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Eupnea ventilator" guid="{guid}" description="{description}" version="{version}" generationTool="Eupnea {version}" variableNamingConvention="flat" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{LIBRARY}" canHandleVariableCommunicationStepSize="true" canNotUseMemoryManagementFunctions="true"/>
  <UnitDefinitions>
{units}  </UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="30" stepSize="{step}"/>
  <ModelVariables>
{variables}    <ScalarVariable name="seed" valueReference="{SEED}" description="Seed of the sensors' noise, as of trainer collect" causality="parameter" variability="fixed" initial="exact"><Integer start="{DEFAULT_SEED}"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs>
{unknowns}    </Outputs>
    <InitialUnknowns>
{unknowns}    </InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"#,
        guid = resources.guid(),
        description =
            escaped(&format!("A ventilator with a learned controller on the bench {}", resources.bench.name)),
        version = env!("CARGO_PKG_VERSION"),
        units = units(),
        variables = variables.concat(),
    )
}

/// All units, once each.
fn units() -> String {
    let mut units: Vec<&str> =
        FIELDS.iter().map(|field| field.unit).chain(OUTPUTS.iter().map(|output| output.unit)).collect();
    units.sort_unstable();
    units.dedup();
    units.iter().map(|unit| format!("    <Unit name=\"{unit}\"/>\n")).collect::<Vec<_>>().concat()
}

fn setting(reference: usize, field: &Field) -> String {
    let Field { name, description, unit, min, max, .. } = field;
    let (description, start) = (escaped(description), field.value(&Settings::default()));
    format!(
        "    <ScalarVariable name=\"{name}\" valueReference=\"{reference}\" description=\"{description}\" causality=\"parameter\" \
         variability=\"tunable\" initial=\"exact\"><Real unit=\"{unit}\" min=\"{min}\" max=\"{max}\" start=\"{start}\"/></ScalarVariable>\n"
    )
}

fn output(reference: usize, output: &Output) -> String {
    let Output { name, unit, description, .. } = output;
    format!(
        "    <ScalarVariable name=\"{name}\" valueReference=\"{reference}\" description=\"{description}\" causality=\"output\" \
         variability=\"discrete\" initial=\"calculated\"><Real unit=\"{unit}\"/></ScalarVariable>\n"
    )
}

/// Text in an attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
