"""Style sheet of the report, on the screen and on paper, and the captions of its figures."""

from __future__ import annotations

from analysis.report.page import STYLE as PAGE_STYLE

STYLE = (
    PAGE_STYLE
    + """
body{max-width:60rem} h2{font-size:1.4rem;margin-top:3rem}
h3{font-size:1.15rem;margin-top:2rem;border-bottom:1px solid #ccd}
h4{font-size:1rem;margin:1.4rem 0 .3rem}
section h2{border-bottom:2px solid #12355b}
.wide{overflow-x:auto} .meta{color:#343a40} .meta td:first-child{white-space:nowrap;font-weight:bold}
table.small{font-size:.78em} table.small td,table.small th{padding:.15rem .35rem;vertical-align:top}
.meta th{text-align:left} .verdict{font-size:1.1rem} .verdict b{display:block;font-size:1.2rem;margin-bottom:.3rem}
table.steps th:nth-child(5),table.steps th:nth-child(6),
table.steps td:nth-child(5),table.steps td:nth-child(6){text-align:left}
.badge{white-space:nowrap;vertical-align:middle}
figure{margin:1.2rem 0;position:relative;break-inside:avoid} figure svg{width:100%;height:auto;display:block}
figcaption{font-size:.85em;color:#343a40} .source{color:#5c677d}
.flight{position:absolute;z-index:2;background:#fff;border:1px solid #12355b;border-radius:3px;
font:12px/1.35 sans-serif;
padding:.25rem .5rem;box-shadow:0 1px 4px #0004;white-space:nowrap;pointer-events:none}
.flight.pinned{pointer-events:auto;cursor:pointer;border-style:dashed}
@page{size:A4;margin:15mm 14mm}
@media print{
 body{font-size:10pt;max-width:none;margin:0;padding:0;color:#000} .screen,.flight.passing{display:none}
 section{break-before:page} h1+p+section,body>section:first-of-type{break-before:auto}
 h2,h3,h4{break-after:avoid} tr{break-inside:avoid} thead{display:table-header-group} .wide{overflow:visible}
 .verdict{background:none;border:1px solid #000;border-left:6px solid #000}
 .badge{color:#000;background:none;border:1.5px solid #000} .simulated{border-style:dashed}
 table.small{font-size:7pt} table.meta{font-size:8pt} a{color:inherit;text-decoration:none}
 figure svg{max-height:235mm}
}
"""
)

CAPTIONS = {
    "bifurcation": "Bifurcation diagram: flight times against gamma, measured (dark dots; crosses: double hit or "
    "unsure) over the prediction for the plate's motion as measured (light). Shaded: flight times forbidden to "
    "the ideal ball.",
    "return_maps": "Return maps of the steps with most modes: each flight time against the one before (dots), and the "
    "predicted cycle (open squares).",
    "history": "Flight times in order of time. Bars: the predicted cycle of each step. Plus signs: the step "
    "still settles.",
    "trajectory": "Plate and ball over a few periods, with the contact voltage below.",
    "motion": "The plate's gain and lag against the drive, one period of its acceleration, and its harmonics.",
    "errors": "Landing error of each step (robust), before (open squares) and after (dots), with the noise floor. "
    "Diamonds: held-out steps.",
    "candidates": "Candidates added alone: gain on steps not fitted, with its standard error. Hatched: rejected.",
    "discovered": "What was discovered beyond the named effects, with its 95 % band.",
    "residuals": "Landings: measured minus predicted, against what might cause them.",
    "takeoffs": "Take-offs: measured minus predicted, against what might cause them.",
    "plate": "The plate against the drive as the model predicts it, before and after.",
}
