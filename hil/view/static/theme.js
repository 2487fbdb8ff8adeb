// Before the first paint: a page that flashes white blinds whoever works at night.
"use strict";
const wanted = localStorage.getItem("servohil.theme");
if (wanted === "light" || wanted === "dark") document.documentElement.dataset.theme = wanted;
