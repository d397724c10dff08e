const canvas=document.getElementById("turn"),pen=canvas.getContext("2d"),names=document.getElementById("names");
const shown=pairs.map(()=>true),all=pairs.flatMap(p=>p.line);
const middle=[0,1,2].map(k=>{const v=all.map(p=>p[k]);return v.length?(Math.min(...v)+Math.max(...v))/2:0});
const reach=Math.max(1,...all.map(p=>Math.hypot(...p.map((v,k)=>v-middle[k]))));
let yaw=-.6,pitch=.5,zoom=1,from=null,wide=900,high=420;
const colour=name=>getComputedStyle(document.documentElement).getPropertyValue(name);
const own=k=>colour("--s"+(k%4+1)),dash=k=>[[],[6,3],[2,3]][Math.floor(k/4)%3];
function place(p){const [x,y,z]=p.map((v,k)=>v-middle[k]),c=Math.cos(yaw),s=Math.sin(yaw),C=Math.cos(pitch),S=Math.sin(pitch);
const scale=zoom*.46*Math.min(wide,high)/reach,a=c*x-s*y,b=s*x+c*y;return [wide/2+scale*a,high/2-scale*(C*z+S*b)]}
function stroke(points,ink,width,dashes){pen.strokeStyle=ink;pen.lineWidth=width;pen.setLineDash(dashes);pen.beginPath();
points.map(place).forEach((q,k)=>k?pen.lineTo(...q):pen.moveTo(...q));pen.stroke()}
function draw(){const ratio=devicePixelRatio||1;wide=canvas.clientWidth;high=canvas.clientHeight;
canvas.width=wide*ratio;canvas.height=high*ratio;pen.setTransform(ratio,0,0,ratio,0,0);pen.font="12px system-ui,sans-serif";
[["x",[10,0,0]],["y",[0,10,0]],["z",[0,0,10]]].forEach(([n,p])=>{stroke([[0,0,0],p],colour("--soft"),1,[]);
pen.fillStyle=colour("--soft");pen.fillText(n+" 10 mm",...place(p))});
pairs.forEach((p,k)=>{if(!shown[k])return;stroke(p.line,own(k),2,dash(k));
if(p.groove){const q=place(p.groove);pen.fillStyle=own(k);pen.beginPath();pen.arc(q[0],q[1],5,0,7);pen.fill()}});
[...names.children].forEach((l,k)=>{l.style.color=own(k)})}
canvas.onpointerdown=e=>{from=[e.clientX,e.clientY];canvas.setPointerCapture(e.pointerId)};
canvas.onpointerup=()=>{from=null};
canvas.onpointermove=e=>{if(!from)return;yaw+=(e.clientX-from[0])*.008;pitch+=(e.clientY-from[1])*.008;from=[e.clientX,e.clientY];draw()};
canvas.onwheel=e=>{e.preventDefault();zoom*=Math.exp(-e.deltaY*.001);draw()};
pairs.forEach((p,k)=>{const l=document.createElement("label"),b=document.createElement("input");b.type="checkbox";b.checked=true;
b.onchange=()=>{shown[k]=b.checked;draw()};l.append(b," ",p.name);names.append(l)});
addEventListener("resize",draw);matchMedia("(prefers-color-scheme: dark)").addEventListener("change",draw);draw();
