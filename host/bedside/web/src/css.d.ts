// Style sheets are bundled by esbuild; they have no value.
declare module "*.css";
