"""How a report page looks: light and dark by the reader's setting; the drawings use the same colour names."""

from typing import Final

CSS: Final = """
:root {
  color-scheme: light dark;
  --paper: #ffffff; --ground: #f4f5f7; --ink: #1b2230; --soft: #566074; --grid: #dfe3ea;
  --true: #1b2230; --estimated: #2563eb; --measured: #a8b0be; --reference: #e07b00;
  --side-a: #0d8a7d; --side-b: #8146d9; --limit: #d42a2a; --good: #23894d; --hold: #4a86e8; --idle: #a3abb8;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #171c25; --ground: #0f131a; --ink: #e9edf4; --soft: #a4aec0; --grid: #2c3442;
    --true: #e9edf4; --estimated: #68a3ff; --measured: #5d687a; --reference: #ffad42;
    --side-a: #37cdb9; --side-b: #b591ff; --limit: #ff6b6b; --good: #4cc581; --hold: #5f98f2; --idle: #667084;
  }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); }
body { font: 15px/1.5 system-ui, "Segoe UI", "Liberation Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 28px 24px 64px; }
header { display: flex; flex-wrap: wrap; align-items: center; gap: 6px 16px; margin-bottom: 16px; }
h1 { font-size: 26px; line-height: 1.2; margin: 0; }
h2 { font-size: 16px; margin: 0 0 6px; }
a { color: var(--estimated); }
.note { color: var(--soft); margin: 0; flex-basis: 100%; }
.mark { display: inline-block; padding: 1px 10px; border: 1.5px solid; border-radius: 99px; white-space: nowrap; }
.mark { font-size: 13px; font-weight: 600; }
.mark.good { color: var(--good); }
.mark.bad { color: var(--limit); }
table { border-collapse: collapse; width: 100%; }
.verdicts, figure, section, .tiles > div { background: var(--paper); border: 1px solid var(--grid); }
.verdicts, figure, section, .tiles > div { border-radius: 8px; }
.verdicts { border-collapse: separate; border-spacing: 0; overflow: hidden; }
.verdicts th, .verdicts td { text-align: left; padding: 7px 16px; border-bottom: 1px solid var(--grid); }
.verdicts tr:last-child td { border-bottom: 0; }
.verdicts th { font-size: 13px; font-weight: 500; color: var(--soft); }
.verdicts .number { text-align: right; font-variant-numeric: tabular-nums; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 10px; margin: 16px 0; }
.tiles > div { padding: 9px 14px; }
.tiles dt { font-size: 13px; color: var(--soft); }
.tiles dd { margin: 0; font-size: 18px; font-weight: 600; font-variant-numeric: tabular-nums; }
.tiles small.more { display: block; }
.tiles small { font-size: 13px; font-weight: 400; color: var(--soft); }
figure, section, main > .note { margin: 16px 0 0; }
figure, section { padding: 16px 20px; }
figcaption { color: var(--soft); font-size: 14px; margin-top: 4px; }
figure svg { display: block; width: 100%; height: auto; }
figure svg text { font-family: inherit !important; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(380px, 1fr)); gap: 16px; }
.facts th { text-align: left; font-weight: 500; color: var(--soft); white-space: nowrap; vertical-align: top; }
.facts th { padding: 2px 18px 2px 0; width: 1%; }
.facts td { overflow-wrap: anywhere; }
pre { overflow-x: auto; font: 13px/1.45 ui-monospace, "Liberation Mono", monospace; }
summary { cursor: pointer; }
@media print { body { background: none; } figure { break-inside: avoid; } }
"""
