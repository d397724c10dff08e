const at=id=>document.getElementById(id),planned=JSON.parse(at("planned").textContent),kept=JSON.parse(at("last").textContent);
const colour=name=>getComputedStyle(document.documentElement).getPropertyValue(name),traces=at("traces");
const named=c=>c.replace(/_(degc|mm|nm|s)$/,(_,u)=>` (${u==="degc"?"°C":u})`).replaceAll("_"," ");
const time=s=>s==null?"?":s<90?`${Math.round(s)} s`:`${Math.round(s/60)} min`;
let state=kept,silent="";
// A pen on a canvas with the ranges of both axes; the vertical one is labelled.
function axes(canvas,[x0,x1],[y0,y1]){const ratio=devicePixelRatio||1,wide=canvas.clientWidth,high=canvas.clientHeight,pen=canvas.getContext("2d");
canvas.width=wide*ratio;canvas.height=high*ratio;pen.setTransform(ratio,0,0,ratio,0,0);pen.font="11px system-ui,sans-serif";
const x=v=>80+(wide-95)*(v-x0)/((x1-x0)||1),y=v=>high-14-(high-32)*(v-y0)/((y1-y0)||1);
pen.fillStyle=colour("--soft");pen.strokeStyle=colour("--grid");
[y0,y1].forEach(v=>{pen.fillText(+v.toFixed(4),6,y(v)+4);pen.beginPath();pen.moveTo(78,y(v));pen.lineTo(wide-12,y(v));pen.stroke()});
return {pen,x,y,high}}
const range=v=>v.length?[v.reduce((a,b)=>Math.min(a,b)),v.reduce((a,b)=>Math.max(a,b))]:[0,1];
function drawPlan(){at("plan").hidden=!planned.length;if(!planned.length)return;
const {pen,x,y,high}=axes(at("plan").querySelector("canvas"),[0,planned.length-1],range(planned.map(p=>p[2]))),r=Math.max(1.5,Math.min(4,300/planned.length));
let past=null;planned.forEach(([step,trajectory,mm,role],k)=>{const done=step<state.step,size=role==="holdout"?2*r:0;
if(trajectory!==past){pen.fillStyle=colour("--soft");pen.fillText(trajectory,x(k)-3,high-1);past=trajectory}
pen.fillStyle=pen.strokeStyle=colour(done?"--s3":"--out");pen.beginPath();
if(size)pen.rect(x(k)-r,y(mm)-r,size,size);else pen.arc(x(k),y(mm),r,0,7);if(done)pen.fill();else pen.stroke()});
const now=planned.findIndex(p=>p[0]>=state.step);if(now<0)return;
pen.strokeStyle=colour("--s2");pen.lineWidth=2;pen.beginPath();pen.moveTo(x(now),12);pen.lineTo(x(now),high-14);pen.stroke()}
function drawTrace(name,k){let figure=traces.children[k-1];
if(!figure){figure=document.createElement("figure");figure.append(document.createElement("canvas"),document.createElement("figcaption"));traces.append(figure)}
const points=state.trace.filter(p=>p[k]!=null),{pen,x,y}=axes(figure.firstChild,range(state.trace.map(p=>p[0])),range(points.map(p=>p[k])));
figure.lastChild.textContent=named(name)+" over time (s)";pen.fillStyle=colour(`--s${(k-1)%4+1}`);
points.forEach(p=>pen.fillRect(x(p[0])-1,y(p[k])-1,2,2))}
function show(){if(!state)return;document.title=`${state.command} ${state.out}`;
at("command").textContent=`wcal ${state.command}`;at("out").textContent=state.out;at("simulated").hidden=!state.simulated;
at("ending").textContent=[state.ending,state.cause,silent].filter(t=>t).join(": ");
const facts=[["readings",planned.length?`${state.readings} of ${planned.length}`:state.readings],["time left",state.ending==="running"?time(state.left_s):"none"],
["scans",state.scans],["lost scans",state.gaps==null?state.lost_scans:`${state.lost_scans} in ${state.gaps} gaps`],...state.status.map(s=>["status",s]),
...state.columns.map((c,k)=>[named(c),state.now[k]==null?"–":+state.now[k].toFixed(4)]).slice(1)];
at("facts").replaceChildren(...facts.map(([name,value])=>{const row=document.createElement("div");
[["dt",name],["dd",value]].forEach(([tag,text])=>{const cell=document.createElement(tag);cell.textContent=text;row.append(cell)});return row}));
at("warnings").replaceChildren(...state.warnings.map(w=>{const line=document.createElement("li");line.textContent=w;return line}));
drawPlan();state.columns.forEach((c,k)=>k&&drawTrace(c,k))}
async function poll(){try{state=await(await fetch("state.json",{signal:AbortSignal.timeout(2000)})).json();silent=""}
catch{silent="no answer: the program has ended or is stopped"}show();if(!silent&&state.ending==="running"||silent)setTimeout(poll,500)}
addEventListener("resize",show);matchMedia("(prefers-color-scheme: dark)").addEventListener("change",show);
if(kept)show();else poll();
